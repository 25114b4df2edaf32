"""What a fit may find of a joint: each parameter's name and its unit in SI, on the joint side."""

PARAMETERS = {
    "motor_inertia": "kg·m²",
    "link_inertia": "kg·m²",
    "inertia": "kg·m²",
    "stiffness": "N·m/rad",
    "damping": "N·m·s/rad",
    "viscous": "N·m·s/rad",
    "coulomb": "N·m",
    "link_coulomb": "N·m",
    "weight_sine": "N·m",
    "weight_cosine": "N·m",
    "delay": "s",
    "resonance": "rad/s",
    "antiresonance": "rad/s",
}
"""`inertia` is both sides' together, of a rigid joint; the friction is the motor's but for `link_coulomb`."""
