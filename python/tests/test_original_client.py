"""A client of another author, like the original's clients (docs/winch.md; the sketch's documents).

It opens the port and does not wait, sends whenever it likes, in bursts of several lines in one write, from a frame loop
of 40 ms; it splits what comes at ``\\n``, strips it, takes lines of exactly 6 words that begin with ``txyza`` as where the
motors are, and only logs all others. It imports nothing of ``pulsetrain_winch``.
"""

from __future__ import annotations

import contextlib
import math
import time
import unittest
from typing import List

from .virtual import VirtualBoard, needs_boards

#: Seven commands in one write of 80 bytes: more than the 64 that an Uno's own serial buffer holds.
BURST = b"version\nenable 1\ng xyza 2.00 1.0\nl xyza 4000 40000\nsrate 40\nd xy 5 -5\nd za 7 -7\n"
FRAME_S = 0.04
#: Boards that read text.
BOARDS = ["winch", "uno", "pico"]
#: How long a computer may need for a few seconds of a board's time, s.
PATIENCE_S = 120.0


class OriginalClient:
    def __init__(self, port: str) -> None:
        import serial  # type: ignore[import-untyped, unused-ignore]

        self.port = serial.Serial(port, 115200, timeout=0)
        self.buffer = b""
        self.position: List[int] = []
        self.usec = 0
        self.statuses = 0
        self.log: List[str] = []

    def send(self, data: bytes) -> None:
        self.port.write(data)

    def poll(self) -> None:
        self.buffer += self.port.read(4096)
        while b"\n" in self.buffer:
            line, self.buffer = self.buffer.split(b"\n", 1)
            tokens = line.strip().decode().split()
            if len(tokens) == 6 and tokens[0] == "txyza":
                self.usec, *self.position = [int(token) for token in tokens[1:]]
                self.statuses += 1
            elif tokens:
                self.log.append(" ".join(tokens))

    def close(self) -> None:
        self.port.close()


@needs_boards
class Original(unittest.TestCase):
    def perform(self, board: str, count: int) -> None:
        """A performance on some boards at once: a burst, circles frame by frame, and a last place for each."""
        self.assertEqual((len(BURST), BURST.count(b"\n")), (80, 7))
        with contextlib.ExitStack() as stack:
            ports = [stack.enter_context(VirtualBoard(board)) for _ in range(count)]
            # The client sends at once, and does not wait for `awake`.
            clients = [OriginalClient(port) for port in ports]
            for client in clients:
                stack.callback(client.close)
                client.send(BURST)
            for frame in range(50):
                for number, client in enumerate(clients):
                    angle = 2 * math.pi * (frame / 25 + number / 4)
                    x, y = round(300 * math.cos(angle)), round(300 * math.sin(angle))
                    client.send(b"a xy %d %d\n" % (x, y))
                    if frame % 10 == 9:
                        client.send(b"d z 100\nd a -100\n" * 2)
                    client.poll()
                time.sleep(FRAME_S)
            for number, client in enumerate(clients):
                client.send(b"a xy %d %d\r\n" % (11 * number, -number))
            patience = time.monotonic() + PATIENCE_S
            for number, client in enumerate(clients):
                # z and a make relative moves. If one were lost, or obeyed twice, they would end elsewhere.
                end = [11 * number, -number, 1007, -1007]
                while client.position != end and time.monotonic() < patience:
                    client.poll()
                    time.sleep(0.01)
                self.assertEqual(client.position, end)
                self.assertGreater(client.statuses, 20)
                others = [line for line in client.log if line != "awake"]
                self.assertEqual(len(others), 1, others)
                self.assertRegex(others[0], r"^id StepperWinch \w{3} \d+ \d{4}$")

    def test_a_performance(self) -> None:
        for board in BOARDS:
            with self.subTest(board):
                self.perform(board, 1)

    def test_four_boards_of_one_host(self) -> None:
        for board in BOARDS:
            with self.subTest(board):
                self.perform(board, 4)

    def test_what_it_does_not_know_is_logged_and_harmless(self) -> None:
        for board in BOARDS:
            with self.subTest(board), VirtualBoard(board) as port:
                client = OriginalClient(port)
                client.send(b"a xqy 40 50\nv x\nhello 1\na x 1e3abc\nsrate -1\n\n\r\na x nan\nversion\n")
                expected = ["err missing 3", "err command 1", "err number 3", "dbg invalid srate value", "err number 3"]
                patience = time.monotonic() + PATIENCE_S
                while client.position != [40, 50, 0, 0] and time.monotonic() < patience:
                    client.poll()
                    time.sleep(0.01)
                client.close()
                self.assertEqual(client.position, [40, 50, 0, 0])
                # Opening a port throws away what came before: under load that can be the board's `awake`.
                others = [line for line in client.log if line != "awake"]
                self.assertEqual(others[:-1], expected)
                self.assertEqual(others[-1][:2], "id")


if __name__ == "__main__":
    unittest.main()
