"""joint.yaml, robot.yaml, gain files and logs: schemas, bounded reading.

One joint       joint_yaml (with its sections; law_section: a law in plain numbers), joint_scenario (what is simulated);
                identified_joint writes one, identified_section is its record; compare_section (what is compared), compared_joint (a
                controller that was found, written); law_export (a controller as difference equations)
A robot         robot_yaml reads, robot_sections has its keys, robot_scenario what is simulated; joint_references (joints in files of
                their own)
Both            system_sections: motor, drive, control (with the types of controllers), limits, ranges; plausibility; file_types tells
                one from the other; edited_text writes values into them; actuator_facts (published figures of actuators, by name)
Command lines   audit_call (an audit, for commands and programs), audit_options (a bare model), readings (what it leaves open),
                audited_robot (as a robot.yaml), simulator_options, sweep_options, typed_requirements; typed_over_gains (beside what
                a file of gains says)
Gains           gain_files reads other people's forms, each in gain_formats, and gain_export writes those of export_forms; joint_gains
                are those of a joint.yaml; law_export (the controller of one joint as difference equations); actuator_export (joints as
                actuators of a trainer); model_keyframes (postures of MJCF); gain_context (the properties of a robot that are stored
                with its gains)
Logs            logs, with a file per format
"""
