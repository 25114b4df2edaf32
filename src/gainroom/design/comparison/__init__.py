"""Controllers of one joint compared at equal robustness.

ceilings          what each is held to: sensitivity, delay reserve, torque noise
objective         what each makes small: a measure of the compliance from load torque to link
exact_joint       sampled responses of the joint to torque command and load torque, at motor, link and spring
joint_responses   the same at one place in its uncertainty, of laws on the host and in the drive
compared_joint    the joint that is compared: in its box and, of a robot, in its states, all other loops closed
opened_loop       its loop at one rate, as margins take it; two_rates: roots with kd in the drive; robot_controllers: the robot with it
structures        laws of a parameter vector; observers: those that hold a model of the joint; catalogue: by the names of files
closed_loop       curves, ceilings and stability of many parameter vectors at once
structure_search  best parameters over the box: global_search, then local_search
coupled_joints    σ_max of several joints closed together; coupled_search: their best parameters
bound             peak compliance that no linear controller on one sensor beats
best_known        the best controller of any structure that a cone programme finds (optional: clarabel)
certificate       the weights that prove it, as a small file that anybody can recompute
dual_grid         what weights prove: the theory, on one grid
closed_maps       every closed loop of a joint, affine in one free stable response
"""
