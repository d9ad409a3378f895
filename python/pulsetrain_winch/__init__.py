"""Client for boards that speak StepperWinch's line protocol (docs/winch.md).

>>> from pulsetrain_winch import Winch
>>> with Winch.open("/dev/ttyACM0") as winch:      # doctest: +SKIP
...     winch.gains("xyza", frequency_hz=1.0, damping_ratio=0.7)
...     winch.move_to(x=800, y=-200)
...     for status in winch.statuses(seconds=3.0):
...         print(status.seconds, status.position("x"))
"""

from .client import AXES, CommandRefused, Message, NoAnswer, Status, Transport, Winch, checksum

__all__ = ["AXES", "CommandRefused", "Message", "NoAnswer", "Status", "Transport", "Winch", "checksum"]
