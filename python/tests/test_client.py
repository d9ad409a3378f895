"""The client against a line of its own, and against virtual boards at pseudo-terminals.

``python3 -m unittest`` in python; `cargo xtask test` does it with all that it needs.
"""

import contextlib
import importlib.util
import os
import subprocess
import sys
import tempfile
import threading
import unittest
from pathlib import Path
from typing import Callable, List, Optional, Tuple

from pulsetrain_winch import CommandRefused, Message, NoAnswer, Status, Winch, checksum
from pulsetrain_winch.client import KEPT

from .virtual import VirtualBoard, needs_boards, needs_pty


class FakeLine:
    """Stores the written bytes, and gives the queued pieces, one for each read. Each read takes 10 ms.

    ``ever``: what comes in each read when the queue is empty.
    """

    def __init__(self, *pieces: bytes, ever: bytes = b"") -> None:
        self.pieces = list(pieces)
        self.ever = ever
        self.written = b""
        self.now = 0.0
        self.closed = False

    def read(self, size: int) -> bytes:
        self.now += 0.01
        return (self.pieces.pop(0) if self.pieces else self.ever)[:size]

    def write(self, data: bytes) -> Optional[int]:
        self.written += data
        return len(data)

    def close(self) -> None:
        self.closed = True


def winch_on(line: FakeLine, **options: bool) -> Winch:
    return Winch(line, clock=lambda: line.now, **options)


class Commands(unittest.TestCase):
    def sent(self, *calls: Callable[[Winch], None], **options: bool) -> List[str]:
        line = FakeLine()
        winch = winch_on(line, **options)
        for call in calls:
            call(winch)
        return line.written.decode().splitlines()

    def test_each_verb_is_a_line(self) -> None:
        self.assertEqual(
            self.sent(
                lambda winch: winch.move_to(a=5, x=7),
                lambda winch: winch.move_by(x=-50),
                lambda winch: winch.drift(z=10, y=-10),
                lambda winch: winch.impulse(x=3),
                lambda winch: winch.ramp(x=400),
                lambda winch: winch.gains(frequency_hz=2, damping_ratio=1.0),
                lambda winch: winch.gains('x', frequency_hz=1 / 3, damping_ratio=0.5),
                lambda winch: winch.limits('xy', speed=4000, acceleration=40_000),
                lambda winch: winch.limits(speed=1e30, acceleration=1e38),
                lambda winch: winch.enable(),
                lambda winch: winch.enable(False),
                lambda winch: winch.report_every(40),
                lambda winch: winch.strict(),
                lambda winch: winch.deadman(500),
            ),
            [
                "a ax 5 7",
                "d x -50",
                "v zy 10 -10",
                "r x 3",
                "s x 400",
                "g xyza 2.000000 1.000000",
                "g x 0.333333 0.500000",
                "l xy 4000.000000 40000.000000",
                "l xyza 1e+30 1e+38",
                "enable 1",
                "enable 0",
                "srate 40",
                "strict 1",
                "deadman 500",
            ],
        )

    def test_checksums(self) -> None:
        self.assertEqual(checksum("ping"), "ping*10")
        self.assertEqual(self.sent(lambda winch: winch.move_to(x=1), with_checksum=True), ["a x 1*28"])

    def test_what_is_refused_here(self) -> None:
        winch = winch_on(FakeLine())
        wrongs: List[Callable[[], object]] = [
            lambda: winch.move_to(),
            lambda: winch.move_to(w=1),
            lambda: winch.move_to(x=1.5),  # type: ignore[arg-type]
            lambda: winch.move_to(x=1 << 31),
            lambda: winch.move_to(x=True),
            lambda: winch.drift(x=float("nan")),  # type: ignore[arg-type]
            lambda: winch.drift(x=float("inf")),  # type: ignore[arg-type]
            lambda: winch.report_every(2.5),  # type: ignore[arg-type]
            lambda: winch.deadman(True),
            lambda: winch.gains(frequency_hz=float("nan"), damping_ratio=1),
            lambda: winch.gains(frequency_hz=1, damping_ratio=True),
            lambda: winch.limits(speed=float("inf"), acceleration=1),
            lambda: winch.wait_until_still(0.5),
            lambda: winch.wait_until_still(0.5, quiet=0.0),
            lambda: winch.gains("", frequency_hz=1, damping_ratio=1),
            lambda: winch.gains("xx", frequency_hz=1, damping_ratio=1),
            lambda: winch.send("a x 1\nenable 0"),
            lambda: winch.send("é"),
            lambda: winch.send("a" * 81),
            lambda: winch.send("a x 1 2 3 4 5 6 7 8 9"),
        ]
        for wrong in wrongs:
            with self.assertRaises(ValueError):
                wrong()


class Hearing(unittest.TestCase):
    def test_statuses_come_in_any_pieces(self) -> None:
        line = FakeLine(b"awa", b"ke\r\ntxyza 1000 1 -2 ", b"3 -4\r\n", b"txyza 201000 5 6 7 8\r\ntxyza bad 1 2 3 4\r\n")
        winch = winch_on(line)
        self.assertEqual(
            list(winch.statuses(0.1)), [Status(0, (1, -2, 3, -4)), Status(200_000, (5, 6, 7, 8))]
        )
        self.assertEqual([str(message) for message in winch.messages()], ["awake", "txyza bad 1 2 3 4"])
        self.assertEqual(winch.messages(), [])

    def test_the_clock_goes_on_when_the_board_s_wraps(self) -> None:
        raw = [2_147_483_000, -2_147_483_296, -1, 100]
        line = FakeLine(*(f"txyza {usec} 0 0 0 0\r\n".encode() for usec in raw))
        times = [status.usec for status in winch_on(line).statuses(0.1)]
        self.assertEqual(times, [0, 1000, 2_147_484_295, 2_147_484_396])

    def test_latest(self) -> None:
        line = FakeLine(b"txyza 0 1 1 1 1\r\ntxyza 1000000 2 3 4 5\r\n")
        winch = winch_on(line)
        latest = winch.latest()
        assert latest is not None
        self.assertEqual((latest.position("x"), latest.position("a"), latest.seconds), (2, 5, 1.0))
        self.assertIsNone(winch.latest())

    def test_latest_comes_back_however_fast_statuses_come(self) -> None:
        for status in (b"txyza 0 1 1 1 1\r\n", b"txyza 0 1 1 1 1\r\n" * 1000):
            line = FakeLine(ever=status)
            latest = winch_on(line).latest()
            assert latest is not None
            self.assertEqual(latest.positions, (1, 1, 1, 1))
            self.assertLess(line.now, 0.2, "seconds")

    def test_what_nobody_asks_for_is_dropped_in_the_end(self) -> None:
        many = KEPT // 100 + 10
        line = FakeLine(*[b"txyza 0 1 1 1 1\r\nerr range 3\r\n" * 100] * many, b"x" * 9000 + b"\r\ntxyza 7 2 2 2 2\r\n")
        winch = winch_on(line)
        while winch.poll():
            pass
        self.assertEqual(len(winch.messages()), KEPT)
        with self.assertRaises(CommandRefused) as refused:
            winch.check()
        self.assertEqual(str(refused.exception).count("err range 3"), KEPT)
        kept = list(winch.statuses(0.0))
        self.assertEqual((len(kept), kept[0].positions), (KEPT, (1, 1, 1, 1)))

    def test_refusals_are_raised_once(self) -> None:
        winch = winch_on(FakeLine(b"err number 3\r\ndbg invalid srate value\r\ndbg hello\r\n"))
        winch.poll()
        with self.assertRaisesRegex(CommandRefused, "^err number 3; dbg invalid srate value$"):
            winch.check()
        winch.check()
        self.assertEqual(winch.messages()[-1], Message(("dbg", "hello")))

    def test_a_check_reads_what_the_board_says(self) -> None:
        line = FakeLine(b"", b"txyza 0 1 1 1 1\r\n", b"err number 3\r\n", b"late\r\n")
        winch = winch_on(line)
        winch.move_to(x=1)
        with self.assertRaisesRegex(CommandRefused, "^err number 3$"):
            winch.check()
        self.assertEqual(line.pieces, [b"late\r\n"], "it waits no longer than it has to")
        line = FakeLine(*[b""] * 40, b"err number 3\r\n")
        winch = winch_on(line)
        winch.check()
        self.assertLess(line.now, 0.1, "seconds")
        with self.assertRaises(CommandRefused):
            winch.check(wait=1.0)

    def test_version_and_ping(self) -> None:
        line = FakeLine(b"", b"awake\r\n", b"id StepperWinch Nov 21 2026\r\n")
        winch = winch_on(line)
        self.assertEqual(winch.version(), "StepperWinch Nov 21 2026")
        self.assertEqual([str(message) for message in winch.messages()], ["awake"], "what was not asked for is kept")
        self.assertEqual(line.written, b"version\n")

    def test_what_was_said_before_the_question_is_no_answer(self) -> None:
        # One is read already, one waits. Only a line after the question is its answer.
        line = FakeLine(b"awake\r\n", b"awake\r\n", b"", b"err number 3\r\n", b"", b"awake\r\n", b"late\r\n")
        winch = winch_on(line)
        winch.poll()
        winch.ping(timeout=1.0)
        with self.assertRaisesRegex(CommandRefused, "^err number 3$"):
            winch.check()
        self.assertEqual([str(message) for message in winch.messages()], ["awake", "awake", "err number 3"])
        self.assertEqual((line.written, line.pieces), (b"ping\n", [b"late\r\n"]))

    def test_a_silent_board(self) -> None:
        line = FakeLine()
        with self.assertRaisesRegex(NoAnswer, "'ping' in 1.0 s"):
            winch_on(line).ping(timeout=1.0)
        self.assertEqual(line.written, b"ping\n" * 4, "asked again and again")

    def test_still(self) -> None:
        lines = [f"txyza {200_000 * n} {min(n, 3)} 0 0 0\r\n".encode() for n in range(9)]
        still = winch_on(FakeLine(b"", *lines)).wait_until_still(1.0)
        self.assertEqual((still.usec, still.positions), (1_200_000, (3, 0, 0, 0)))
        with self.assertRaisesRegex(NoAnswer, "not still for 0.05 s within 0.1 s"):
            winch_on(FakeLine(b"", *lines[:4])).wait_until_still(0.1, quiet=0.05)
        with self.assertRaisesRegex(NoAnswer, "no status came in 0.1 s"):
            winch_on(FakeLine()).wait_until_still(0.1, quiet=0.05)

    def test_rest_before_the_question_is_none(self) -> None:
        before = [f"txyza {200_000 * n} 0 0 0 0\r\n".encode() for n in range(9)]
        after = [f"txyza {200_000 * (9 + n)} {min(n, 3)} 0 0 0\r\n".encode() for n in range(9)]
        line = FakeLine(*before, b"", *after)
        winch = winch_on(line)
        for _ in before[:-1]:
            winch.poll()
        winch.move_to(x=3)
        self.assertEqual(winch.wait_until_still(1.0).positions, (3, 0, 0, 0))

    def test_closing(self) -> None:
        line = FakeLine()
        with winch_on(line):
            self.assertFalse(line.closed)
        self.assertTrue(line.closed)


@needs_pty
class PseudoTerminal(unittest.TestCase):
    def test_a_board_behind_a_pty(self) -> None:
        board, port = os.openpty()
        heard: List[bytes] = []

        def answer() -> None:
            text = b""
            while b"ping" not in text:
                text += os.read(board, 100)
            heard.append(text)
            os.write(board, b"awake\r\ntxyza 5 1 2 3 4\r\n")

        thread = threading.Thread(target=answer)
        thread.start()
        with Winch.open(os.ttyname(port)) as winch:
            winch.move_to(x=1)
            winch.ping(timeout=10.0)
            thread.join()
            status = next(winch.statuses(10.0))
        self.assertTrue(heard[0].startswith(b"a x 1\nping\n"), heard)
        self.assertEqual(status.positions, (1, 2, 3, 4))
        os.close(board)
        os.close(port)


@needs_boards
class VirtualBoards(unittest.TestCase):
    #: Boards that read text.
    BOARDS = ["winch", "uno", "pico"]

    def assert_goes_to(self, winch: Winch, positions: Tuple[int, int, int, int]) -> None:
        """The axis reaches its target, and stays there."""
        for status in winch.statuses(60.0):
            if status.positions == positions:
                break
        self.assertEqual(winch.wait_until_still(60.0).positions, positions)

    def test_a_client_does_not_wait_and_is_obeyed(self) -> None:
        for board in self.BOARDS:
            with self.subTest(board), VirtualBoard(board) as port, Winch.open(port) as winch:
                self.assertTrue(winch.version(timeout=30.0).startswith("StepperWinch"))
                winch.report_every(20)
                winch.gains(frequency_hz=3, damping_ratio=1)
                winch.limits(speed=8000, acceleration=100_000)
                for _ in range(100):
                    winch.move_by(x=10)
                winch.move_to(a=5, y=-300)
                self.assert_goes_to(winch, (1000, -300, 0, 5))
                winch.check()
                winch.send("a x ten")
                winch.ping(timeout=30.0)
                with self.assertRaisesRegex(CommandRefused, "^err number 3$"):
                    winch.check()

    def test_four_boards_at_once(self) -> None:
        for board in self.BOARDS:
            with self.subTest(board), contextlib.ExitStack() as stack:
                ports = [stack.enter_context(VirtualBoard(board)) for _ in range(4)]
                winches = [stack.enter_context(Winch.open(port)) for port in ports]
                for number, winch in enumerate(winches, 1):
                    winch.gains(frequency_hz=3, damping_ratio=1)
                    winch.move_to(x=100 * number, a=-number)
                for number, winch in enumerate(winches, 1):
                    self.assert_goes_to(winch, (100 * number, 0, 0, -number))

    def test_the_example_plots_a_run(self) -> None:
        """With matplotlib a picture, without it a table."""
        example = Path(__file__).resolve().parents[1] / "examples/plot_run.py"
        has_plots = importlib.util.find_spec("matplotlib") is not None
        for plots in [True, False] if has_plots else [False]:
            with self.subTest(plots=plots), VirtualBoard("winch") as port, tempfile.TemporaryDirectory() as folder:
                (Path(folder) / "without").mkdir()
                (Path(folder) / "without/matplotlib.py").write_text("raise ImportError\n")
                hidden = [] if plots else [str(Path(folder) / "without")]
                path = os.pathsep.join([*hidden, str(example.parents[1])])
                run = subprocess.run(
                    [sys.executable, str(example), port],
                    cwd=folder,
                    env={**os.environ, "PYTHONPATH": path},
                    capture_output=True,
                    text=True,
                )
                self.assertEqual((run.returncode, run.stderr), (0, ""))
                name, in_the_end, *table = run.stdout.splitlines()
                self.assertTrue(name.startswith("StepperWinch"), name)
                self.assertRegex(in_the_end, r"^[1-9]\d* statuses; in the end at \(")
                if plots:
                    self.assertEqual(table, ["run.svg"])
                    self.assertIn("</svg>", (Path(folder) / "run.svg").read_text())
                else:
                    self.assertEqual(table[0], "seconds x y z a")


if __name__ == "__main__":
    unittest.main()
