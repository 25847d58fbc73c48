"""Files of a robot's diagnosis: page, tables, and the robot as found."""
