"""Durations of jerk-limited moves, as the ruckig package plans them.

One move a line on standard input: distance, largest speed, acceleration and jerk, start speed.
One duration, s, a line on standard output.
"""

import sys

from ruckig import InputParameter, Result, Ruckig, Trajectory

for line in sys.stdin:
    distance, speed, acceleration, jerk, start_speed = map(float, line.split())
    move = InputParameter(1)
    move.target_position = [distance]
    move.max_velocity = [speed]
    move.max_acceleration = [acceleration]
    move.max_jerk = [jerk]
    move.current_velocity = [start_speed]
    trajectory = Trajectory(1)
    if Ruckig(1).calculate(move, trajectory) not in (Result.Working, Result.Finished):
        sys.exit(f"ruckig cannot plan: {line}")
    print(repr(trajectory.duration))
