"""A robot of 32 joints for what depends on their number: TALOS with elastic gearboxes."""


def talos(contacts: str) -> str:
    """Text of its robot.yaml, on `contacts` as YAML."""
    return f"""
model: {{package: example-robot-data, file: talos_reduced.urdf, base: floating}}
joints: {{default: {{motor_inertia: 0.1, stiffness: 10000.0, damping: 1.0}}}}
drive: {{bandwidth: 4000.0, delay_ms: 2.0}}
postures: {{half_sitting: {{"leg_.*_3_joint": -0.4, "leg_.*_4_joint": 0.8, "leg_.*_5_joint": -0.4}}}}
contacts: {contacts}
control: {{type: pd, space: joint, feedback: motor, kp: 400.0, kd: 20.0}}
limits: {{gain_margin_db: 6.0}}
"""
