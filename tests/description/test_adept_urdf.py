"""The bundled arm against Gueaieb et al. (2007): the paper's M, Q and tip pose at 200 random states."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

URDF = Path(__file__).resolve().parents[2] / "urdf" / "adept_3dof.urdf"

# The paper's numbers, section 4.
L1, L2, R2 = 0.425, 0.375, 0.165
M2, M3 = 15.0, 5.0
I1, I2, I3, I_COL = 1.1, 0.3, 0.01, 0.57
A = I1 + M2 * L1**2 + M3 * L1**2
B = M2 * L1 * R2 + M3 * L1 * L2
C = I_COL + I2 + I3 + M2 * R2**2 + M3 * L2**2

T = np.array([[1.0, 0, 0], [1, 1, 0], [0, 0, 1]])  # q_drive = T q: the paper's first two angles are absolute


def paper_mass(q_drive):
    coupling = B * np.cos(q_drive[1] - q_drive[0])
    return np.array([[A, coupling, 0], [coupling, C, I3], [0, I3, I3]])


def paper_coriolis(q_drive, v_drive):
    coupling = B * np.sin(q_drive[1] - q_drive[0])
    return np.array([[0, -coupling * v_drive[1], 0], [coupling * v_drive[0], 0, 0], [0, 0, 0]])


@pytest.fixture(scope="module")
def model():
    return pin.buildModelFromUrdf(str(URDF))


@pytest.fixture(scope="module")
def states():
    rng = np.random.default_rng(2007)
    return list(zip(rng.uniform(-np.pi, np.pi, (200, 3)), rng.uniform(-5, 5, (200, 3)), strict=True))


def test_the_papers_constants_are_the_stated_ones():
    assert_allclose([A, B, C], [4.7125, 1.84875, 1.9915], rtol=1e-14)


def test_joints_are_a_chain_of_three_turns_about_z(model):
    assert list(model.names) == ["universe", "joint_1", "joint_2", "joint_3"]
    assert [joint.shortname() for joint in model.joints][1:] == ["JointModelRZ"] * 3


def test_mass_matrix_in_drive_coordinates_is_the_papers(model, states):
    data = model.createData()
    for q, _ in states:
        upper = np.triu(pin.crba(model, data, q))
        mass = upper + np.triu(upper, 1).T
        assert_allclose(T.T @ paper_mass(T @ q) @ T, mass, rtol=1e-12, atol=1e-12)


def test_coriolis_and_centrifugal_torques_are_the_papers(model, states):
    data = model.createData()
    level = model.copy()
    level.gravity = pin.Motion.Zero()
    for q, v in states:
        expected = T.T @ paper_coriolis(T @ q, T @ v) @ (T @ v)
        assert_allclose(pin.nonLinearEffects(level, data, q, v), expected, rtol=1e-12, atol=1e-12)


def test_gravity_across_the_plane_needs_no_torque(model, states):
    data = model.createData()
    for q, _ in states:
        assert_allclose(pin.computeGeneralizedGravity(model, data, q), 0, atol=1e-12)


def test_tip_is_the_papers_closed_form_in_the_plane_of_the_base(model, states):
    data = model.createData()
    tip = model.getFrameId("tip", pin.FrameType.BODY)
    assert tip < model.nframes
    for q, _ in states:
        q1, q2, q3 = T @ q
        pin.framesForwardKinematics(model, data, q)
        X_BE = data.oMf[tip]
        position = [L1 * np.cos(q1) + L2 * np.cos(q2), L1 * np.sin(q1) + L2 * np.sin(q2), 0]
        assert_allclose(X_BE.translation, position, rtol=0, atol=1e-14)
        assert X_BE.translation[2] == 0
        c, s = np.cos(q2 + q3), np.sin(q2 + q3)
        assert_allclose(X_BE.rotation, [[c, -s, 0], [s, c, 0], [0, 0, 1]], rtol=0, atol=1e-14)


def test_every_link_is_a_body_that_can_exist(model):
    """The second moments of mass about the centre of mass, S = tr(I) / 2 - I, are positive definite."""
    assert_allclose([inertia.mass for inertia in model.inertias][1:], [30, 15, 5], rtol=0)
    for inertia in list(model.inertias)[1:]:
        second_moments = 0.5 * np.trace(inertia.inertia) * np.eye(3) - inertia.inertia
        assert np.linalg.eigvalsh(second_moments).min() > 0


def test_link_1_has_the_papers_inertia_about_its_joint(model):
    link_1 = model.inertias[model.getJointId("joint_1")]
    assert_allclose(link_1.inertia[2, 2] + link_1.mass * link_1.lever[0] ** 2, I1, rtol=1e-14)


def test_file_holds_no_friction_and_needs_no_mesh():
    root = ET.parse(URDF).getroot()
    assert list(root.iter("dynamics")) == []
    assert list(root.iter("mesh")) == []
    assert len(list(root.iter("visual"))) > 10
