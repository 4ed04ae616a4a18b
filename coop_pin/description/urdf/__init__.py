"""URDF files: search, and check before Pinocchio reads them.

Open first: ``check`` (all checks of a text or a file), ``find`` (by path or name of a robot), ``report``
(findings). ``lint``, ``inertia``, ``tree`` and ``meshes`` (by ``packages``) are the checks, ``loops`` reads
closures, ``xacro`` expands, ``robot`` has kinematics without Pinocchio.

Pinocchio reads a mass of "abc" or "1.0 " as zero, drops a joint if a link has two parents, accepts a zero
axis, and crashes on a chain of 20 000 links. The check reports every defect with a code, its link or joint,
and its line.

**Structural** findings are always errors: Pinocchio would refuse the file or read something other than it
says.

- document: ``size``, ``empty``, ``encoding``, ``not_xml``, ``doctype``, ``elements``, ``nesting``, ``root``,
  ``xacro``
- names: ``name``, ``reserved_name``, ``duplicate_link``, ``duplicate_joint``, ``duplicate_material``,
  ``no_links``
- values: ``number``, ``not_finite``, ``count``, ``negative``, ``mesh_unreadable``, ``line_break``,
  ``missing_attribute``, ``duplicate_element``
- joints: ``joint_type``, ``axis_zero``, ``limit_missing``, ``limit_inverted``, ``mimic_self``,
  ``mimic_unknown``
- tree: ``no_parent``, ``no_child``, ``unknown_parent``, ``unknown_child``, ``two_parents``, ``cycle``,
  ``no_root``, ``two_roots``, ``depth``
- loops: ``loop`` (an arm has none; a mechanism's is read as a closure), ``loop_unread``; both are doubtful
  for arms of bundled files and example-robot-data, and no finding among parts that locked joints make one

**Physical** findings are warnings, and errors if strict: no body has such a mass or inertia. ``mass_zero``
(with an inertia), ``mass_negative``, ``inertia_not_psd`` and ``inertia_triangle`` are **impossible** in a
user's file if the body that joints move is so, after fixed and locked joints are merged. Unless repaired,
these are always errors: Pinocchio would integrate a motion that no body has. A moved link without mass is
not, as its joint may be locked; if it is not, the arm's model is refused.

- ``mass_missing``, ``mass_zero``, ``mass_negative``, ``massless_body``, ``inertia_missing``,
  ``inertia_not_psd``, ``inertia_triangle``

**Doubtful** findings are always warnings: readable, but probably not intended.

- ``limit_degrees``, ``origin_far``, ``passive_joint``, and for files ``mesh_missing``
"""

from coop_pin.description.urdf.check import check_file, check_urdf, load_checked, text_checked
from coop_pin.description.urdf.find import UrdfFile, bundled_urdf_folder, find_urdf, robot_files
from coop_pin.description.urdf.report import UrdfFinding, UrdfReport

__all__ = [
    "UrdfFile",
    "UrdfFinding",
    "UrdfReport",
    "bundled_urdf_folder",
    "check_file",
    "check_urdf",
    "find_urdf",
    "load_checked",
    "robot_files",
    "text_checked",
]
