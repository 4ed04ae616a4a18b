"""Exudyn: rigid bodies in maximal coordinates, generic joints as grasps and guides."""

import importlib.metadata

import exudyn as exu
import numpy as np
from cases import Case
from engine import about_P
from exudyn.itemInterface import LoadForceVector, LoadTorqueVector, MarkerBodyRigid
from exudyn.rigidBodyUtilities import RigidBodyInertia

H, RADIUS = 1e-3, 0.7


class Exudyn:
    """A joint with a free axis is a hinge, a spring damper a compliant grasp."""

    name = f"Exudyn {importlib.metadata.version('exudyn')}"
    settings = f"generalised alpha, index 3, {H:g} s, spectral radius {RADIUS:g}, dense solver"
    reading = (
        "`ForceLocal`, `TorqueLocal` by `GetObjectOutput`, in the joint's axes on its first body; moments are"
        " multipliers: m_y, m_z negated; of a hinge (m_y, -m_x), in axes of the second body"
    )

    def wrenches(self, case: Case) -> np.ndarray:
        mbs = exu.SystemContainer().AddSystem()
        ground, bodies, grasps = mbs.CreateGround(), [], []
        payload = self.body(mbs, case, case.mass, case.inertia, np.zeros(3))
        for hand in case.hands:
            bodies.append(body := self.body(mbs, case, hand.mass, hand.inertia, hand.tip))
            u = [value if axis in hand.guides else 0.0 for axis, value in enumerate(hand.drive)]
            marker = mbs.AddMarker(MarkerBodyRigid(bodyNumber=body))
            for kind, load in ((LoadForceVector, u[:3]), (LoadTorqueVector, u[3:])):
                mbs.AddLoad(kind(markerNumber=marker, loadVector=load))
            tip, origin = list(hand.tip), [0.0, 0.0, 0.0]
            joint = {"position": tip, "useGlobalFrame": True, "show": False}
            if any(standing := [int(axis not in hand.guides) for axis in range(6)]):
                mbs.CreateGenericJoint(itemNumbers=[ground, body], constrainedAxes=standing, **joint)
            if np.any(hand.stiffness):
                at = {"itemNumbers": [ground, body], "localPosition0": tip, "localPosition1": origin}
                K, D = np.diag(hand.stiffness), np.diag(hand.damping)
                mbs.CreateRigidBodySpringDamper(stiffness=K, damping=D, offset=list(hand.anchor), **at)
            items, K, D = {"itemNumbers": [payload, body]}, np.diag(hand.spring), np.diag(hand.damper)
            if hand.grasp == "spring":
                at = items | {"localPosition0": tip, "localPosition1": origin}
                at |= {"rotationMatrixJoint": hand.rotation, "useIntrinsicFormulation": False}
                grasps.append(mbs.CreateRigidBodySpringDamper(stiffness=K, damping=D, **at))
            else:
                held = [1, 1, 1, 1, 1, int(hand.grasp == "rigid")]
                axes = items | {"rotationMatrixAxes": hand.rotation}
                grasps.append(mbs.CreateGenericJoint(constrainedAxes=held, **axes, **joint))
        mbs.Assemble()
        settings = exu.SimulationSettings()
        time, linear = settings.timeIntegration, settings.linearSolverSettings
        time.endTime, time.numberOfSteps, time.verboseMode = case.time, round(case.time / H), 0
        time.generalizedAlpha.spectralRadius, time.newton.relativeTolerance = RADIUS, 1e-12
        settings.solutionSettings.writeSolutionToFile, linear.ignoreSingularJacobian = False, True
        settings.linearSolverType = exu.LinearSolverType.EigenDense
        mbs.SolveDynamic(settings, storeSolver=False)
        wrenches = []
        for hand, body, each in zip(case.hands, bodies, grasps, strict=True):
            kinds = exu.OutputVariableType.ForceLocal, exu.OutputVariableType.TorqueLocal
            f, raw = (mbs.GetObjectOutput(each, kind) for kind in kinds)
            rows = {"spring": raw, "rigid": raw * (1, -1, -1), "hinge": np.array((raw[1], -raw[0], 0.0))}
            X = self.turn(mbs, payload).T @ self.turn(mbs, body) if hand.grasp == "hinge" else np.eye(3)
            m = hand.rotation.T @ X @ hand.rotation @ rows[hand.grasp]
            wrenches.append(about_P(hand, f, m))
        return np.array(wrenches)

    def turn(self, mbs: exu.MainSystem, body: object) -> np.ndarray:
        kind = exu.OutputVariableType.RotationMatrix
        return np.reshape(mbs.GetObjectOutputBody(body, kind, [0, 0, 0]), (3, 3))

    def body(self, mbs: exu.MainSystem, case: Case, mass: float, inertia: object, tip: object) -> object:
        omega = np.array((0.0, 0.0, case.spin))
        velocity, inertia = np.cross(omega, tip), RigidBodyInertia(mass, np.diag(inertia))
        start = {"initialVelocity": list(velocity), "initialAngularVelocity": list(omega)}
        start |= {"referencePosition": list(tip), "gravity": list(case.gravity)}
        return mbs.CreateRigidBody(inertia=inertia, **start)
