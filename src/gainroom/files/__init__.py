"""joint.yaml, robot.yaml, gain files and logs: schemas, bounded reading."""
