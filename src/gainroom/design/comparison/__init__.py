"""Controllers of one joint compared at equal robustness.

ceilings      what each is held to: sensitivity, delay reserve, torque noise
exact_joint   sampled responses of the joint to torque command and load torque, at motor, link and spring
"""
