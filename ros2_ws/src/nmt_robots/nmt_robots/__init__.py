"""Robots: a model as MJCF or URDF, a log of its joints, and why they differ, joint by joint.

* :mod:`nmt_robots.model`: joints, limits and rigid-body torque of a robot, by MuJoCo.
* :mod:`nmt_robots.log`: logs of joints (NPZ, CSV, bags of ``sensor_msgs/JointState``) and their sidecar.
* :mod:`nmt_robots.log_faults`: what is wrong with the log itself: clock, rows, command, velocity, torque.
* :mod:`nmt_robots.mechanics`: friction, armature and their rivals by least squares on the inverse dynamics.
* :mod:`nmt_robots.verdict`: the answer for each joint and for the log, and the motion that would tell more.
* :mod:`nmt_robots.report`: the page, the tables, and the robot file with what was found.
"""
