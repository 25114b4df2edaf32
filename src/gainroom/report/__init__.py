"""Results → pictures and pages.

`X_presentation.py` is all that is shown of a study, in one record: keys of --json, lines of the terminal, page. `X.py` is the page of a
command, `X_text.py` its sentences, `X_columns.py` its numbers as columns of terminal, JSON, page and documentation.

joint        joint_presentation; joint, joint_text, joint_tables; gain_map and map_lines; bode
robot        robot_presentation; robot, robot_text, robot_columns, robot_tables (states, joints, tasks), recommended_gains; robot_units;
             pictures: robot_drawing, robot_skeleton, robot_headroom, robot_loci
audit        audit_presentation; audit, audit_text, audit_advice, audit_headroom; gearboxes, simulator_text
simulate     simulation_presentation; simulation, simulation_text, simulation_advice, simulation_figures; curves
sweep        sweep_presentation; sweep, sweep_text; workspace: a sweep as a part of another page
verify       verification_presentation; verification, verification_text
identify     identification, identified_text, identification_advice, identification_figures, delay_text, log_text, estimates; plan;
             diagnosis_presentation; diagnosis, diagnosis_text, diagnosis_advice
of several   words (every sentence about safety), verdict (requirements and gains to use, first on every page), gains_to_use,
             margin_columns, columns, presentation, page (HTML), page_parts, number_format, style; two_paths
"""
