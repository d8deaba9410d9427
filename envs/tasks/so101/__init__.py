"""Tasks of an SO-101 on a table: the twin of LeRobot's arm, 30 Hz, two cameras of 640×480 pixels."""
