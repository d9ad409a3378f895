"""A run, step by step, as in a notebook: each `# %%` begins a cell.

    python3 examples/plot_run.py /dev/ttyACM0

Without a board: `pulsetrain board winch --pty /tmp/winch`, or `board uno --image winch` for the firmware on
an emulated chip, is a port that takes its place.
"""

# %% The board
import sys
from typing import List

from pulsetrain_winch import AXES, Status, Winch

port = sys.argv[1] if len(sys.argv) > 1 else "/dev/ttyACM0"
winch = Winch.open(port)
print(winch.version())

# %% How it is to move: quick and damped, a status every 20 ms
winch.gains(frequency_hz=1.0, damping_ratio=0.4)
winch.limits(speed=3500, acceleration=35_000)
winch.report_every(20)

# %% A gesture: there, further in mid-move, and back
run: List[Status] = []
winch.move_to(x=800, y=400)
run += winch.statuses(0.6)
winch.move_by(x=600)
winch.impulse(y=-100)
run += winch.statuses(1.5)
winch.move_to(x=0, y=0)
run += winch.statuses(3.0)
winch.check()
winch.close()
print(f"{len(run)} statuses; in the end at {run[-1].positions if run else 'nowhere'}")

# %% What it did
try:
    import matplotlib.pyplot as plt
except ImportError:
    print("seconds " + " ".join(AXES))
    for status in run[::10]:
        print(f"{status.seconds:7.2f} " + " ".join(str(position) for position in status.positions))
else:
    figure, plot = plt.subplots()
    for axis in "xy":
        plot.plot([status.seconds for status in run], [status.position(axis) for status in run], label=axis)
    plot.set_xlabel("s")
    plot.set_ylabel("steps")
    plot.legend()
    figure.savefig("run.svg")
    print("run.svg")
