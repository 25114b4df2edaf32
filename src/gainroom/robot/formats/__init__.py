"""URDF and MJCF, read as hostile input.

Every format   model_files (FORMATS), model_format (what one does), model_names (where a model's file is), xml_text (bounds)
URDF           urdf
MJCF           mjcf_file trims it, mjcf_compiler compiles it in a guarded child, mjcf reads links, joints and armature from what is
               compiled, mjcf_constraints what holds them together; mujoco_messages
In memory      in_memory: an MjModel, an MjSpec, a pinocchio.Model as MJCF
"""
