"""Definitions of internal force that the literature argues about: properties, and where they coincide."""

from itertools import combinations

import numpy as np
import pytest
from cells import SCENARIOS

import coop_pin as cp
from coop_pin.base.errors import ShapeError
from coop_pin.base.spatial import internal_wrenches, rotate_vector6, rotation_from_rpy, shift_wrench
from coop_pin.base.spatial.internal_wrench import (
    constraint_consistent_internal_wrenches,
    determinate_grasp,
    minimum_norm_internal_wrenches,
    nonsqueezing_internal_wrenches,
    symmetric_internal_wrenches,
    virtual_linkage,
    virtual_linkage_internal_wrenches,
)

RNG = np.random.default_rng(3)
MASSES, INERTIAS = np.array([2.0, 3.0, 0.5]), np.array([0.02, 0.05, 0.03])


def shares(m):
    return np.array([0.5, 0.3, 0.2])[:m] / np.array([0.5, 0.3, 0.2])[:m].sum()


DEFINITIONS = {
    "load shares": lambda F, r: internal_wrenches(F, shares(r.shape[-2])),
    "minimum norm": minimum_norm_internal_wrenches,
    "nonsqueezing": nonsqueezing_internal_wrenches,
    "virtual linkage": virtual_linkage_internal_wrenches,
    "constraint consistent": lambda F, r: constraint_consistent_internal_wrenches(
        F, r, MASSES[: r.shape[-2]], INERTIAS[: r.shape[-2]]
    ),
}
ANY_UNIT_OF_LENGTH = set(DEFINITIONS) - {"minimum norm"}


def grasp(m):
    """Wrenches about P and tips of ten samples."""
    return RNG.normal(size=(10, m, 6)) * 20.0, RNG.normal(size=(10, m, 3)) * 0.3


@pytest.mark.parametrize("m", [2, 3])
@pytest.mark.parametrize("name", DEFINITIONS)
def test_internal_wrenches_sum_to_zero_do_no_work_and_are_left_alone(name, m):
    F, r = grasp(m)
    f = DEFINITIONS[name](F, r)
    assert np.abs(f).max() > 1.0
    np.testing.assert_allclose(f.sum(axis=1), 0.0, atol=1e-10)
    V = RNG.normal(size=(10, 1, 6))  # of the payload; tip i moves with [v + w x r_i, w]
    at_tips, velocity = shift_wrench(f, -r), V.copy().repeat(m, axis=1)
    velocity[..., :3] += np.cross(V[..., 3:], r)
    np.testing.assert_allclose((at_tips * velocity).sum(axis=(1, 2)), 0.0, atol=1e-11)
    np.testing.assert_allclose(DEFINITIONS[name](f, r), f, atol=1e-11)  # a projection


@pytest.mark.parametrize("m", [2, 3])
@pytest.mark.parametrize("name", DEFINITIONS)
def test_the_split_does_not_depend_on_the_reference_point(name, m):
    F, r = grasp(m)
    d = np.array([0.4, -0.2, 0.7])  # P seen from the other point
    np.testing.assert_allclose(
        DEFINITIONS[name](shift_wrench(F, d), r + d), shift_wrench(DEFINITIONS[name](F, r), d), atol=1e-11
    )


@pytest.mark.parametrize("m", [2, 3])
@pytest.mark.parametrize("name", DEFINITIONS)
def test_only_the_minimum_norm_depends_on_the_unit_of_length(name, m):
    F, r = grasp(m)
    mm, definition = np.array([1.0, 1.0, 1.0, 1e3, 1e3, 1e3]), DEFINITIONS[name]
    if name == "constraint consistent":
        in_mm = constraint_consistent_internal_wrenches(F * mm, r * 1e3, MASSES[:m], INERTIAS[:m] * 1e6) / mm
    else:
        in_mm = definition(F * mm, r * 1e3) / mm
    difference = np.abs(in_mm - definition(F, r)).max()
    assert difference < 1e-6 if name in ANY_UNIT_OF_LENGTH else difference > 1.0


@pytest.mark.parametrize("m", [2, 3])
@pytest.mark.parametrize("name", DEFINITIONS)
def test_samples_may_have_any_leading_axes(name, m):
    F, r = grasp(m)
    f = DEFINITIONS[name](F, r)
    table = DEFINITIONS[name](F.reshape(2, 5, m, 6), r.reshape(2, 5, m, 3))
    np.testing.assert_allclose(table.reshape(f.shape), f, atol=1e-11)
    np.testing.assert_allclose(DEFINITIONS[name](F[3], r[3]), f[3], atol=1e-11)


def test_of_two_arms_the_symmetric_and_the_nonsqueezing_split_are_that_by_equal_load_shares():
    F, r = grasp(2)
    equal = internal_wrenches(F, np.array([0.5, 0.5]))
    np.testing.assert_allclose(symmetric_internal_wrenches(F), equal, atol=1e-13)
    np.testing.assert_allclose(nonsqueezing_internal_wrenches(F, r), equal, atol=1e-12)
    F, r = grasp(3)
    np.testing.assert_allclose(
        nonsqueezing_internal_wrenches(F, r), internal_wrenches(F, np.ones(3) / 3), atol=1e-12
    )


def test_the_minimum_norm_is_that_of_the_pseudo_inverse_of_the_grasp_matrix():
    F, r = grasp(3)
    for wrenches, tips, found in zip(F, r, minimum_norm_internal_wrenches(F, r), strict=True):
        G = np.hstack([shift_wrench(np.eye(6), np.broadcast_to(tip, (6, 3))).T for tip in tips])
        h = shift_wrench(wrenches, -tips).ravel()
        internal = h - np.linalg.pinv(G) @ (G @ h)
        np.testing.assert_allclose(shift_wrench(internal.reshape(3, 6), tips), found, atol=1e-11)


def test_tensions_of_the_virtual_linkage_are_the_forces_along_its_edges():
    """Without tip moments the internal forces are combinations of the unit vectors between the tips."""
    _, r = grasp(3)
    forces = RNG.normal(size=(10, 3, 3))
    F = np.concatenate((forces, np.cross(r, forces)), axis=-1)
    f = virtual_linkage_internal_wrenches(F, r)
    for tips, force, internal in zip(r, forces, f, strict=True):
        edges = np.zeros((9, 3))
        for column, (i, j) in enumerate([(0, 1), (1, 2), (2, 0)]):
            edge = (tips[j] - tips[i]) / np.linalg.norm(tips[j] - tips[i])
            edges[3 * i : 3 * i + 3, column], edges[3 * j : 3 * j + 3, column] = edge, -edge
        tensions = np.linalg.lstsq(edges, force.ravel(), rcond=None)[0]
        np.testing.assert_allclose(internal[:, :3].ravel(), edges @ tensions, atol=1e-11)
        np.testing.assert_allclose(shift_wrench(internal, -tips)[:, 3:], 0.0, atol=1e-11)


# ---------------------------------------------------------------- struts of the virtual linkage

SQUARE = np.array([(0.3, 0.3, 0.1), (-0.3, 0.3, 0.1), (-0.3, -0.3, 0.1), (0.3, -0.3, 0.1)])
SELF_STRESS = np.array([1.0, -np.sqrt(2.0), 1.0, 1.0, -np.sqrt(2.0), 1.0]) / np.sqrt(8.0)
"""Of a square: its sides pull as its diagonals push; pairs in the order 12, 13, 14, 23, 24, 34."""
LINE = np.array([(-0.4, 0.0, 0.0), (0.1, 0.0, 0.0), (0.5, 0.0, 0.0)])
TURNED = rotation_from_rpy((0.4, -0.7, 1.1))


def strut_wrenches(tips, tensions, twists):
    """Wrenches on the arms about P that struts cause, summed strut by strut."""
    wrenches = np.zeros((len(tips), 6))
    for (i, j), tension, twist in zip(combinations(range(len(tips)), 2), tensions, twists, strict=True):
        u = (tips[j] - tips[i]) / np.linalg.norm(tips[j] - tips[i])
        for end, sign in ((i, 1.0), (j, -1.0)):
            force = sign * tension * u
            wrenches[end] += np.concatenate((force, np.cross(tips[end], force) + sign * twist * u))
    return wrenches


@pytest.mark.parametrize("m", [2, 3, 4])
def test_struts_and_their_rest_are_the_internal_wrench_and_no_strut_can_carry_the_rest(m):
    F, r = grasp(m)
    struts, rest = virtual_linkage(F, r)
    at_tips = shift_wrench(virtual_linkage_internal_wrenches(F, r), -r)
    for tips, strut, left, internal in zip(r, struts, rest, at_tips, strict=True):
        carried = shift_wrench(strut_wrenches(tips, *strut.T), -tips)
        np.testing.assert_allclose(carried + left, internal, atol=1e-10)
        for i, j in combinations(range(m), 2):
            for part in (left[:, :3], left[:, 3:]):
                assert abs((part[i] - part[j]) @ (tips[j] - tips[i])) < 1e-10


@pytest.mark.parametrize("m", [2, 3, 4])
def test_tensions_and_twists_in_general_position_are_found_again_with_their_sign(m):
    _, r = grasp(m)
    pairs = m * (m - 1) // 2
    for tips in r:
        tension, twist = RNG.normal(size=(2, pairs))
        struts, rest = virtual_linkage(strut_wrenches(tips, tension, 0.0 * twist), tips)
        np.testing.assert_allclose(struts, np.column_stack((tension, 0.0 * twist)), atol=1e-9)
        np.testing.assert_allclose(rest, 0.0, atol=1e-9)
        found = virtual_linkage(strut_wrenches(tips, tension, twist), tips).struts
        np.testing.assert_allclose(found[:, 1], twist, atol=1e-9)


def test_the_strut_of_two_arms_has_half_of_the_difference_along_the_line():
    F, r = grasp(2)
    struts, _ = virtual_linkage(F, r)
    u = (r[:, 1] - r[:, 0]) / np.linalg.norm(r[:, 1] - r[:, 0], axis=1, keepdims=True)
    half = (shift_wrench(F, -r)[:, 0] - shift_wrench(F, -r)[:, 1]) / 2.0
    np.testing.assert_allclose(struts[:, 0, 0], (half[:, :3] * u).sum(axis=1), atol=1e-10)
    np.testing.assert_allclose(struts[:, 0, 1], (half[:, 3:] * u).sum(axis=1), atol=1e-10)


@pytest.mark.parametrize("turn", [np.eye(3), TURNED], ids=["level", "turned"])
def test_struts_of_coplanar_and_collinear_tips_have_the_tensions_of_least_norm(turn):
    tips = SQUARE @ turn.T
    alone = virtual_linkage(strut_wrenches(tips, SELF_STRESS, np.zeros(6)), tips)
    np.testing.assert_allclose(alone.struts, 0.0, atol=1e-12)  # it moves no arm, and no wrench shows it
    tension = RNG.normal(size=6)
    found = virtual_linkage(strut_wrenches(tips, tension, np.zeros(6)), tips)
    np.testing.assert_allclose(
        found.struts[:, 0], tension - (SELF_STRESS @ tension) * SELF_STRESS, atol=1e-10
    )
    warping = np.array([1.0, -1.0, 1.0, -1.0])[:, None] * turn[:, 2]  # out of the plane, alternately
    held = np.concatenate((warping, np.cross(tips, warping)), axis=1)
    struts, rest = virtual_linkage(held, tips)
    np.testing.assert_allclose(struts, 0.0, atol=1e-10)
    np.testing.assert_allclose(rest[:, :3], warping, atol=1e-10)

    line = LINE @ turn.T
    tension = np.array([4.0, 0.0, 4.0])  # 12, 13, 23: least norm 4/3, 8/3, 4/3, of the same forces
    struts, _ = virtual_linkage(strut_wrenches(line, tension, np.zeros(3)), line)
    np.testing.assert_allclose(struts[:, 0], [4 / 3, 8 / 3, 4 / 3], atol=1e-9)
    nearly = tips + 1e-9 * RNG.normal(size=tips.shape)  # as the closure error of a run moves them
    np.testing.assert_allclose(virtual_linkage(held, nearly).struts, 0.0, atol=1e-6)


@pytest.mark.parametrize("name", SCENARIOS)
def test_the_strut_of_a_run_has_the_forces_of_its_definition_along_the_line(name):
    """The cells are planar, and spatial with grasp frames turned away from the world."""
    data = (result := cp.run(SCENARIOS[name]().replace(events=(), duration=0.2), warn=False)).data
    r = data["tip_position"].values - data["payload_position"].values[:, None]
    struts, _ = virtual_linkage(*determinate_grasp(data["interaction_wrench"].values, r))
    f = result.internal_wrench_definitions()["virtual_linkage"].values[:, 0, :3]
    line = data["tip_position"].values[:, 1] - data["tip_position"].values[:, 0]
    along = (np.nan_to_num(f) * line).sum(axis=1) / np.linalg.norm(line, axis=1)
    np.testing.assert_allclose(struts[:, 0, 0], along, rtol=1e-9, atol=1e-9)
    assert np.abs(along).max() > 0.1


@pytest.mark.parametrize("name", sorted(ANY_UNIT_OF_LENGTH))
@pytest.mark.parametrize("middle", [0.0, 0.2])
def test_the_split_of_two_arms_turns_with_the_world(name, middle):
    """From the x axis to all of (1, -1, 0) and the other axes, with P in the middle of the tips and not."""
    F, _ = grasp(2)
    r = np.array([(-0.3 + middle, 0.0, 0.0), (0.3 + middle, 0.0, 0.0)])
    expected = DEFINITIONS[name](F[0], r)
    for rpy in ((0.0, 0.0, -np.pi / 4), (0.0, np.pi / 2, 0.0), (0.3, 0.0, np.pi / 2)):
        R = rotation_from_rpy(rpy)
        found = DEFINITIONS[name](rotate_vector6(R, F[0]), r @ R.T)
        np.testing.assert_allclose(found, rotate_vector6(R, expected), atol=1e-11)


def test_tips_count_as_collinear_by_the_ratio_of_their_spreads():
    """Three tips along 100 m, one of them 1e-8 m off the line, are collinear; a triangle of 0.1 um is not."""
    F, _ = grasp(3)
    line = np.array([(0.0, 0.0, 0.0), (60.0, 0.0, 0.0), (100.0, 0.0, 0.0)])
    nearly = line + np.array([(0.0, 0.0, 0.0), (0.0, 1e-8, 0.0), (0.0, 0.0, 0.0)])
    np.testing.assert_allclose(
        virtual_linkage_internal_wrenches(F[0], nearly),
        virtual_linkage_internal_wrenches(F[0], line),
        atol=1e-5,
    )
    triangle, small = np.array([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.4, 2e-3, 0.0)]), 1e-7
    unit = np.array([1.0, 1.0, 1.0, small, small, small])
    expected = virtual_linkage_internal_wrenches(F[0], triangle)
    found = virtual_linkage_internal_wrenches(F[0] * unit, triangle * small) / unit
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())


def test_the_constraint_consistent_load_accelerates_the_virtual_bodies_as_one_rigid_body():
    F, r = grasp(3)
    load = F - constraint_consistent_internal_wrenches(F, r, MASSES, INERTIAS)
    at_tips = shift_wrench(load, -r)
    linear, angular = at_tips[..., :3] / MASSES[:, None], at_tips[..., 3:] / INERTIAS[:, None]
    np.testing.assert_allclose(angular, angular[:, :1].repeat(3, axis=1), atol=1e-9)
    np.testing.assert_allclose(
        linear - np.cross(angular, r), (linear - np.cross(angular, r))[:, :1].repeat(3, 1), atol=1e-9
    )


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_result_has_every_definition_of_its_internal_wrench(name):
    scenario = SCENARIOS[name]().replace(events=(), duration=0.1)
    result = cp.run(scenario, warn=False)
    found, F = result.internal_wrench_definitions(), result.data["interaction_wrench"]
    np.testing.assert_allclose(found["load_shares"], result.data["internal_wrench"], atol=1e-12)
    determined = np.isfinite(F.values)
    tips = (
        (result.data["tip_position"] - result.data["payload_position"]).transpose("time", "arm", ...).values
    )
    r, values = np.where(determined[..., :3], tips, 0.0), np.where(determined, F.values, 0.0)
    payload, c = scenario.cell.payload, np.array(scenario.cell.shares)
    expected = {
        "minimum_norm": minimum_norm_internal_wrenches(values, r),
        "nonsqueezing": nonsqueezing_internal_wrenches(values, r),
        "virtual_linkage": virtual_linkage_internal_wrenches(values, r),
        "constraint_consistent": constraint_consistent_internal_wrenches(
            values, r, c * payload.mass, c * np.trace(payload.inertia_matrix) / 3.0
        ),
        "symmetric": symmetric_internal_wrenches(values),
    }
    assert set(found) == {"load_shares", *expected}
    for definition, wrenches in expected.items():
        np.testing.assert_allclose(
            found[definition].values[determined], wrenches[determined], atol=1e-12, rtol=1e-12
        )
    for values in found.values():
        assert values.dims == F.dims
        np.testing.assert_array_equal(np.isnan(values), np.isnan(F))
        np.testing.assert_allclose(values.sum("arm", skipna=False).fillna(0.0), 0.0, atol=1e-9)
    squeeze = found["virtual_linkage"].isel(time=-1)
    assert np.isfinite(squeeze.sel(axis="x")).all()


def test_tips_that_do_not_fit_the_wrenches_are_refused():
    with pytest.raises(ShapeError):
        minimum_norm_internal_wrenches(np.zeros(6), np.zeros(3))
    with pytest.raises(ShapeError):
        minimum_norm_internal_wrenches(np.zeros((2, 6)), np.zeros((3, 3)))
