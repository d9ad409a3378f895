"""Durations of jerk-limited moves, as the ruckig package plans them.

One move a line on standard input: distance, largest speed, acceleration and jerk, start speed.
One duration, s, a line on standard output.
"""

import sys

from ruckig import InputParameter, Result, Ruckig, Trajectory

for line in sys.stdin:
    distance, speed, acceleration, jerk, start_speed = map(float, line.split())
    # In units of the largest speed: ruckig's own tolerances are absolute, and refuse or miss moves of 1e5 steps.
    move = InputParameter(1)
    move.target_position = [distance / speed]
    move.max_velocity = [1.0]
    move.max_acceleration = [acceleration / speed]
    move.max_jerk = [jerk / speed]
    move.current_velocity = [start_speed / speed]
    trajectory = Trajectory(1)
    if Ruckig(1).calculate(move, trajectory) not in (Result.Working, Result.Finished):
        sys.exit(f"ruckig cannot plan: {line}")
    print(repr(trajectory.duration))
