"""Pinocchio 4: the gains of Baumgarte are read by one name and set by another; other names set nothing."""

import pinocchio as pin

model = pin.buildSampleModelManipulator()
at = pin.SE3.Identity()
closure = pin.RigidConstraintModel(pin.ContactType.CONTACT_6D, model, 6, at, 0, at, pin.LOCAL)
closure.Kp, closure.corrector = 10.0, pin.BaumgarteCorrectorParameters(10.0, 2.0)  # accepted
print("comes:", closure.m_baumgarte_parameters.Kp)
closure.setBaumgarteCorrectorParameters(pin.BaumgarteCorrectorParameters(10.0, 2.0))
print("right:", closure.m_baumgarte_parameters.Kp)
