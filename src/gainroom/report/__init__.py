"""Presentation of results: terminal text, JSON, pictures and pages.

`X.py` is the page of a command, `X_text.py` its sentences, `X_columns.py` its numbers as columns of terminal, JSON, page and documentation.
XPresentation holds all of it, in one record for command, page and app; it is in `X_tables.py` for a joint and a robot, otherwise in
`X_text.py`.

joint        joint, joint_text, joint_tables; gain_map, map_lines and map_labels; bode; over_time
robot        robot, robot_text, robot_columns, robot_tables (states, joints, tasks), recommended_gains; robot_units;
             pictures: robot_drawing, robot_skeleton, robot_headroom
audit        audit, audit_text; gearboxes, simulator_text
simulate     simulation, simulation_text; curves
sweep        sweep, sweep_text; workspace: a sweep as a part of another page
verify       verification, verification_text
compare      comparison, comparison_text; coupled_comparison: of several joints together
actuators    actuator_text
identify     identification, identified_text, log_text, estimate_columns; plan; diagnosis, diagnosis_text
programs     study_records: a study's numbers, card and picture in Python
shared       words (every sentence about safety), gain_advice (gains to use, beside the requirements, first on every page), gains_to_use
             (as lines of a file), next_commands, margin_columns, columns, presentation, page (HTML), page_parts, number_format, style;
             gain_paths
"""
