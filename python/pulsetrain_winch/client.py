"""The client: sends a line for each command, and collects the board's lines."""

from __future__ import annotations

import math
import time
from collections import deque
from dataclasses import dataclass
from types import TracebackType
from typing import Callable, Deque, Dict, Iterator, List, Optional, Protocol, Tuple, Type, Union

#: The axes, in the order of a status line.
AXES = "xyza"

#: The line's rate, baud; 8 data bits, no parity, 1 stop bit, no flow control.
BAUD = 115_200

#: Number of statuses, and of other lines, that are kept until the program reads them. Older ones are dropped.
KEPT = 10_000

#: Bytes of a read: more than a board sends within the line's timeout.
_READ = 4096
#: Full reads in a row: enough for all that an operating system may have stored, but limited, so that no call lasts for ever.
_READS = 16

_WRAP = 1 << 32
_HALF = 1 << 31


class Transport(Protocol):
    """The methods of a line that the client needs. ``serial.Serial`` has them."""

    def read(self, size: int) -> bytes:
        """Up to ``size`` bytes; none if nothing came within the line's own timeout."""

    def write(self, data: bytes) -> Optional[int]:
        """Sends ``data``."""

    def close(self) -> None:
        """Closes the line."""


@dataclass(frozen=True)
class Status:
    """The motors' positions: one ``txyza`` line."""

    #: The board's clock since this client's first status, µs. It does not wrap, though the number in the line does after 71.6 min.
    usec: int
    #: Steps made, by axis in the order of :data:`AXES`.
    positions: Tuple[int, int, int, int]

    @property
    def seconds(self) -> float:
        """The board's clock since this client's first status, s."""
        return self.usec / 1e6

    def position(self, axis: str) -> int:
        """Steps made by ``axis``: x, y, z or a."""
        return self.positions[AXES.index(axis)]


@dataclass(frozen=True)
class Message:
    """A line that is not a status: ``awake``, ``id …``, ``dbg …``, ``err …``."""

    #: The line's words.
    words: Tuple[str, ...]

    @property
    def is_error(self) -> bool:
        """Whether this line refuses a command."""
        return self.words[0] == "err" or self.words[:2] in (("dbg", "invalid"), ("dbg", "excessive"))

    def __str__(self) -> str:
        return " ".join(self.words)


class CommandRefused(Exception):
    """The board has refused a line and done nothing."""


class NoAnswer(Exception):
    """The board did not answer in time."""


def checksum(line: str) -> str:
    """``line`` with its checksum: ``*`` and the exclusive or of all bytes before it, in hexadecimal.

    >>> checksum("a x 1")
    'a x 1*28'
    """
    total = 0
    for byte in line.encode("ascii"):
        total ^= byte
    return f"{line}*{total:02x}"


class Winch:
    """A board, with the protocol's own verbs.

    Values are whole steps or steps/s; each command names its axes, as keywords (``x=5``) or as flags (``"xy"``).
    A board answers commands of motion and gains only if it refuses them: :meth:`check` raises its refusals.
    """

    def __init__(
        self, transport: Transport, *, with_checksum: bool = False, clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Uses an open line. ``with_checksum``: each command gets a checksum, which the original sketch does not know."""
        self._transport = transport
        self._with_checksum = with_checksum
        self._clock = clock
        self._partial = b""
        self._statuses: Deque[Status] = deque(maxlen=KEPT)
        self._messages: Deque[Message] = deque(maxlen=KEPT)
        self._last_raw: Optional[int] = None
        self._usec = 0
        self._errors: Deque[Message] = deque(maxlen=KEPT)

    @classmethod
    def open(cls, port: str, *, with_checksum: bool = False) -> "Winch":
        """Opens a serial port or pseudo-terminal with pyserial.

        An Uno starts anew when its port is opened, and its bootloader takes what is sent for a second or two: ask for
        :meth:`version` first, which waits until the board answers.
        """
        import serial  # type: ignore[import-untyped, unused-ignore]

        return cls(serial.Serial(port, BAUD, timeout=0.02), with_checksum=with_checksum)

    def close(self) -> None:
        """Closes the line. The board goes on with its last commands."""
        self._transport.close()

    def __enter__(self) -> "Winch":
        return self

    def __exit__(
        self,
        kind: Optional[Type[BaseException]],
        error: Optional[BaseException],
        trace: Optional[TracebackType],
    ) -> None:
        self.close()

    # Commands to the board.

    def move_to(self, **targets: int) -> None:
        """``a``: absolute targets, steps. The drivers are enabled."""
        self._axes("a", targets)

    def move_by(self, **offsets: int) -> None:
        """``d``: targets relative to the present ones, steps. The drivers are enabled."""
        self._axes("d", offsets)

    def drift(self, **speeds: int) -> None:
        """``v``: the targets drift on at these speeds, steps/s, until the next command. The drivers are enabled."""
        self._axes("v", speeds)

    def impulse(self, **steps: int) -> None:
        """``r``: reference and target move by these steps at once, with any ramp."""
        self._axes("r", steps)

    def ramp(self, **speeds: int) -> None:
        """``s``: the greatest speed of the reference to new targets, steps/s; 0 or less: it jumps."""
        self._axes("s", speeds)

    def gains(self, axes: str = AXES, *, frequency_hz: float, damping_ratio: float) -> None:
        """``g``: natural frequency (0.01 to 20 Hz) and damping ratio (0.07 to 5; 1 is critical)."""
        self.send(f"g {_flags(axes)} {_decimal(frequency_hz)} {_decimal(damping_ratio)}")

    def limits(self, axes: str = AXES, *, speed: float, acceleration: float) -> None:
        """``l``: the highest speed, steps/s, and acceleration, steps/s², at least 1.

        Larger values are reduced to 10 000 steps/s and 250 000 steps/s².
        """
        self.send(f"l {_flags(axes)} {_decimal(speed)} {_decimal(acceleration)}")

    def enable(self, on: bool = True) -> None:
        """``enable``: switches the drivers on; or stops the motors within their limits and then switches the drivers off."""
        self.send(f"enable {int(on)}")

    def report_every(self, milliseconds: int) -> None:
        """``srate``: the interval of status lines, ms."""
        self.send(f"srate {_whole(milliseconds)}")

    def strict(self, on: bool = True) -> None:
        """``strict``: whether the board refuses irregular lines. Boards with the original's firmware ignore it."""
        self.send(f"strict {int(on)}")

    def deadman(self, milliseconds: int) -> None:
        """``deadman``: after this time without a line, ms, the board stops all axes; 0: never. The original ignores it."""
        self.send(f"deadman {_whole(milliseconds)}")

    def send(self, line: str) -> None:
        """Sends a line as it is.

        Raises :exc:`ValueError` if it has more than 80 bytes or 10 words, or is not printable ASCII.
        """
        text = checksum(line) if self._with_checksum else line
        if not text.isascii() or not text.isprintable():
            raise ValueError(f"not printable ASCII: {text!r}")
        if len(text) > 80 or len(line.split()) > 10:
            raise ValueError(f"a line has at most 80 bytes and 10 words: {text!r}")
        self._transport.write(text.encode("ascii") + b"\n")

    # Lines from the board.

    def poll(self) -> bool:
        """Reads what has come from the line. Gives whether there was anything. Waits no longer than the line's timeout."""
        return self._take() > 0

    def statuses(self, seconds: float) -> Iterator[Status]:
        """Statuses as they come, for a number of seconds by this computer's clock."""
        end = self._clock() + seconds
        while True:
            while self._statuses:
                yield self._statuses.popleft()
            if self._clock() >= end:
                return
            self.poll()

    def latest(self) -> Optional[Status]:
        """The newest status; ``None`` if none has come since the last call.

        Waits no longer than the line's timeout, however often statuses come.
        """
        self._catch_up()
        last = self._statuses[-1] if self._statuses else None
        self._statuses.clear()
        return last

    def messages(self) -> List[Message]:
        """All other lines since the last call."""
        taken = list(self._messages)
        self._messages.clear()
        return taken

    def check(self, wait: float = 0.05) -> None:
        """Raises :exc:`CommandRefused` if the board has refused a line since the last check.

        It reads the port for ``wait`` seconds, or until a refusal has come. A board answers a line within some milliseconds,
        the line's own time included; a burst of lines, or an adapter that holds bytes back, needs more.
        """
        end = self._clock() + wait
        while not self._errors and self._clock() < end:
            self.poll()
        errors = list(self._errors)
        self._errors.clear()
        if errors:
            raise CommandRefused("; ".join(str(error) for error in errors))

    def ping(self, timeout: float = 3.0) -> None:
        """Waits until the board sends ``awake``. Raises :exc:`NoAnswer` after ``timeout`` seconds.

        It asks again and again, since an Uno is deaf for about a second after its port was opened. Lines from before the
        call are no answer.
        """
        self._ask("ping", "awake", timeout)

    def version(self, timeout: float = 3.0) -> str:
        """The board's name for itself. Raises :exc:`NoAnswer` after ``timeout`` seconds."""
        return " ".join(self._ask("version", "id", timeout).words[1:])

    def wait_until_still(self, timeout: float, *, quiet: float = 0.5) -> Status:
        """The first status after which no motor has moved for ``quiet`` seconds of the board's clock.

        Statuses that came before the call do not count. A motion with fewer than one step in ``quiet`` seconds looks still:
        a drift or a ramp of few steps/s, the beginning and the end of a move with a low natural frequency. There ``quiet``
        has to be longer. Raises :exc:`NoAnswer` after ``timeout`` seconds of this computer's clock, and :exc:`ValueError` if
        that is no longer than ``quiet``, so that nothing could be seen.
        """
        if not 0 < quiet < timeout:
            raise ValueError(f"quiet must be more than 0 and less than the timeout of {timeout} s: {quiet!r}")
        self._catch_up()
        self._statuses.clear()
        still: Optional[Status] = None
        for status in self.statuses(timeout):
            if still is None or still.positions != status.positions:
                still = status
            elif status.usec - still.usec >= quiet * 1e6:
                return status
        if still is None:
            raise NoAnswer(f"no status came in {timeout} s")
        raise NoAnswer(f"the motors were not still for {quiet} s within {timeout} s")

    def _ask(self, question: str, answer: str, timeout: float) -> Message:
        self._catch_up()
        others = self.messages()
        end, again = self._clock() + timeout, 0.0
        try:
            while self._clock() < end:
                if self._clock() >= again:
                    self.send(question)
                    again = self._clock() + 0.25
                self.poll()
                while self._messages:
                    message = self._messages.popleft()
                    if message.words[0] == answer:
                        return message
                    others.append(message)
        finally:
            self._messages = deque([*others, *self._messages], maxlen=KEPT)
        raise NoAnswer(f"no answer to {question!r} in {timeout} s")

    def _catch_up(self) -> None:
        """Reads everything that waits: a read that is not full has reached the end."""
        for _ in range(_READS):
            if self._take() < _READ:
                return

    def _take(self) -> int:
        """Reads once. Gives the number of bytes."""
        data = self._transport.read(_READ)
        *lines, self._partial = (self._partial + data).split(b"\n")
        # No line of a board is that long, so it is noise.
        self._partial = self._partial[-_READ:]
        for raw in lines:
            self._hear(raw.decode("ascii", "replace").split())
        return len(data)

    def _axes(self, verb: str, values: Dict[str, int]) -> None:
        if not values:
            raise ValueError(f"{verb!r} needs at least one axis, such as x=100")
        numbers = " ".join(str(_whole(value)) for value in values.values())
        self.send(f"{verb} {_flags(''.join(values))} {numbers}")

    def _hear(self, words: List[str]) -> None:
        if not words:
            return
        status = _status(words)
        if status is None:
            message = Message(tuple(words))
            self._messages.append(message)
            if message.is_error:
                self._errors.append(message)
            return
        raw, positions = status
        # The clock wraps, so only differences count. Statuses must be less than 35 minutes apart.
        if self._last_raw is not None:
            self._usec += (raw - self._last_raw + _HALF) % _WRAP - _HALF
        self._last_raw = raw
        self._statuses.append(Status(self._usec, positions))


def _status(words: List[str]) -> Optional[Tuple[int, Tuple[int, int, int, int]]]:
    if len(words) != 6 or words[0] != "txyza":
        return None
    try:
        usec, x, y, z, a = (int(word) for word in words[1:])
    except ValueError:
        return None
    return usec, (x, y, z, a)


def _flags(axes: str) -> str:
    if not axes or any(axis not in AXES for axis in axes) or len(set(axes)) != len(axes):
        raise ValueError(f"axes are x, y, z and a, each at most once: {axes!r}")
    return axes


def _number(value: Union[int, float]) -> Union[int, float]:
    # Python takes True for 1. Here it is a mistake.
    if isinstance(value, bool) or not math.isfinite(value):
        raise ValueError(f"not a number: {value!r}")
    return value


def _decimal(value: float) -> str:
    number = _number(value)
    # A large number with all its digits would not fit into a line.
    return f"{number:.6f}" if abs(number) < 1e9 else f"{number:.9g}"


def _whole(value: Union[int, float]) -> int:
    if _number(value) != int(value):
        raise ValueError(f"not a whole number: {value!r}")
    if not -_HALF <= value < _HALF:
        raise ValueError(f"more than 32 bits: {value!r}")
    return int(value)
