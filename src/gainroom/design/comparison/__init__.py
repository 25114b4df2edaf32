"""Controllers of one joint compared at equal robustness.

exact_joint   sampled responses of the joint to torque command and load torque, at motor, link and spring
"""
