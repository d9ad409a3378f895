"""OSC packets of python-osc, against the program that shows what Pulsetrain understands of them.

`cargo xtask test` runs it with python-osc, and with the program in ``PULSETRAIN_OSC_MONITOR``.
"""

import importlib.util
import json
import os
import socket
import subprocess
import tempfile
import time
import unittest
from pathlib import Path
from typing import Any, Dict, List, Optional, cast


def monitor() -> Optional[str]:
    """The program: the one in ``PULSETRAIN_OSC_MONITOR``, else the debug build."""
    built = Path(__file__).resolve().parents[2] / "target/debug/examples/osc_monitor"
    known = [os.environ.get("PULSETRAIN_OSC_MONITOR"), str(built)]
    return next((path for path in known if path and Path(path).exists()), None)


@unittest.skipUnless(
    importlib.util.find_spec("pythonosc") and monitor(),
    "needs python-osc, and `cargo build -p pulsetrain --example osc_monitor`",
)
class PythonOsc(unittest.TestCase):
    def setUp(self) -> None:
        from pythonosc.udp_client import SimpleUDPClient

        self.process = subprocess.Popen([monitor() or "", "0"], stdout=subprocess.PIPE, text=True)
        self.addCleanup(self.process.wait)
        self.addCleanup(self.process.kill)
        assert self.process.stdout is not None
        self.addCleanup(self.process.stdout.close)
        self.port = int(self.line()["listens"].rsplit(":", 1)[1])
        # A timeout that only a broken program reaches.
        self.client = SimpleUDPClient("127.0.0.1", self.port, timeout=60)
        self.addCleanup(self.client.close)

    def line(self) -> Dict[str, Any]:
        assert self.process.stdout is not None
        line: Dict[str, Any] = json.loads(self.process.stdout.readline())
        return line

    def requests(self) -> List[Any]:
        requests: List[Any] = self.line()["requests"]
        return requests

    def heard(self) -> List[Any]:
        """The next answer: its address, and its values."""
        message = next(iter(self.client.get_messages()))
        return [message.address, *message.params]

    def test_messages(self) -> None:
        self.client.send_message("/wildness", 0.7)
        self.assertEqual(self.requests(), [{"command": "set", "knob": "wildness", "value": 0.7}])
        self.client.send_message("/pulsetrain/second/frequency", "0.9 Hz")
        self.assertEqual(self.requests(), [{"command": "set", "knob": "second.frequency", "value": "0.9 Hz"}])
        self.client.send_message("/pause", [])
        self.assertEqual(self.requests(), [{"command": "pause"}])
        self.client.send_message("/cue", "storm")
        self.assertEqual(self.requests(), [{"command": "cue", "name": "storm"}])

    def test_a_bundle_has_one_time(self) -> None:
        from pythonosc.osc_bundle_builder import OscBundleBuilder
        from pythonosc.osc_message_builder import OscMessageBuilder

        bundle = OscBundleBuilder(int(time.time()) + 30)
        for address, value in [("/tempo", 0.5), ("/wildness", 1)]:
            message = OscMessageBuilder(address)
            message.add_arg(value)
            bundle.add_content(message.build())
        self.client.send(bundle.build())
        line = self.line()
        self.assertEqual([request["command"] for request in line["requests"]], ["tempo", "set"])
        self.assertGreater(line["in_ms"], 0)
        self.assertLessEqual(line["in_ms"], 30_000)

    def test_answers(self) -> None:
        self.client.send_message("/setDestIp", [])
        self.assertEqual(self.heard(), ["/destIp", 127, 0, 0, 1, 1])
        self.client.send_message("/setPositionReportInterval", [2, 1])
        self.client.send_message("/go", 1)
        self.assertEqual(self.requests(), [{"command": "go"}])
        self.assertEqual(self.heard(), ["/position", 2, -1])
        self.client.send_message("/getPositionList", [])
        self.assertEqual(self.heard(), ["/positionList", 1, -1])
        self.client.send_message("/wildnes", 1)
        address, why, motor = self.heard()
        self.assertEqual((address, motor), ("/error/command", 0))
        self.assertIn("/wildnes: this address is unknown; there are /pulsetrain/knob/wildness", why)
        self.client.send_message("/hardStop", 255)
        self.assertEqual(self.requests(), [{"command": "stop_now"}])
        self.assertEqual(self.process.wait(60), 0)

    def test_the_page_shows_python_that_runs(self) -> None:
        page = (Path(__file__).resolve().parents[2] / "docs/osc.md").read_text(encoding="utf-8")
        shown = page.split("```python\n")[1].split("```")[0]
        for here, there in [("9000", str(self.port)), ("timeout=1", "timeout=60")]:
            self.assertIn(here, shown)
            shown = shown.replace(here, there)
        # Positions are known soon after the first command, when they are reported.
        self.client.send_message("/setDestIp", [])
        self.assertEqual(self.heard()[0], "/destIp")
        self.client.send_message("/setPositionReportInterval", [2, 1])
        self.client.send_message("/go", 1)
        self.assertEqual(self.requests(), [{"command": "go"}])
        self.assertEqual(self.heard(), ["/position", 2, -1])
        printed: List[Any] = []

        class Complete(Exception):
            pass

        def show(*values: Any) -> None:
            printed.append(values)
            if values[0] == "/positionList":
                raise Complete

        names: Dict[str, Any] = {"print": show}
        with self.assertRaises(Complete):
            exec(shown, names)
        names["client"].close()
        self.assertEqual(self.requests(), [{"command": "set", "knob": "second.frequency", "value": "0.9 Hz"}])
        self.assertEqual(printed[0], ("/destIp", [127, 0, 0, 1, 1]))
        _, (first, second) = printed[1]
        self.assertGreaterEqual(first, 1)
        self.assertEqual(first, -second)



LIVE = """
board = "uno"
[motor.a]
steps_per_rev = 200
driver = "A4988"
pins = { step = 8, dir = 9 }
forward = "high"
max_speed = "4 rev/s"
max_acceleration = "30 rev/s^2"
[motor.b]
steps_per_rev = 200
driver = "A4988"
pins = { step = 10, dir = 11 }
forward = "high"
max_speed = "4 rev/s"
max_acceleration = "30 rev/s^2"
[[motion]]
motors = ["a", "b"]
law.sweep = { frequency = "1 Hz", swing = "40 step" }
"""


def program() -> Optional[str]:
    """Pulsetrain: the one in ``PULSETRAIN``, else the debug build."""
    built = Path(__file__).resolve().parents[2] / "target/debug/pulsetrain"
    known = [os.environ.get("PULSETRAIN"), str(built)]
    return next((path for path in known if path and Path(path).exists()), None)


@unittest.skipUnless(
    importlib.util.find_spec("pythonosc") and program(),
    "needs python-osc, and `cargo build -p pulsetrain`",
)
class LiveMotion(unittest.TestCase):
    def test_the_changes_of_a_bundle_share_a_tick_at_its_time(self) -> None:
        from pythonosc.osc_bundle_builder import OscBundleBuilder
        from pythonosc.osc_message_builder import OscMessageBuilder
        from pythonosc.udp_client import SimpleUDPClient

        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        (Path(folder.name) / "m.toml").write_text(LIVE)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        arguments = ["live", "m.toml", "--native", "--quiet", "--log", "m.jsonl", "--osc", str(port)]
        environment = {**os.environ, "XDG_RUNTIME_DIR": folder.name}
        live = subprocess.Popen(
            [program() or "", *arguments],
            cwd=folder.name,
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self.addCleanup(live.wait)
        self.addCleanup(live.kill)
        assert live.stdin is not None and live.stdout is not None
        self.addCleanup(live.stdin.close)
        self.addCleanup(live.stdout.close)
        self.assertIn("runs", live.stdout.readline())
        # A timeout that only a broken program reaches.
        client = SimpleUDPClient("127.0.0.1", port, timeout=60)
        self.addCleanup(client.close)
        client.send_message("/setDestIp", [])
        next(iter(client.get_messages()))
        # Times that are far enough ahead for a busy computer; the second has a value that is too much.
        begin = time.time() + 2
        sent = [(begin, "20 step", "2 Hz"), (begin + 1.25, "30 step", "50 Hz")]
        for tag, swing, frequency in sent:
            # The library takes fractions of a second, which its annotation leaves out.
            bundle = OscBundleBuilder(cast(int, tag))
            for address, value in [("/pulsetrain/a/swing", swing), ("/pulsetrain/b/frequency", frequency)]:
                message = OscMessageBuilder(address)
                message.add_arg(value)
                bundle.add_content(message.build())
            client.send(bundle.build())
        told = [line for line in (live.stdout.readline() for _ in range(4)) if " from " in line]
        self.assertEqual(len(told), 4)
        # Nearer than a change can begin: the sender hears how late the bundle acts. Some of them may be just in time.
        for number in range(100):
            near = OscBundleBuilder(cast(int, time.time() + 0.003))
            message = OscMessageBuilder("/pulsetrain/a/swing")
            message.add_arg(f"{22 + 2 * (number % 2)} step")
            near.add_content(message.build())
            client.send(near.build())
            answer = next(iter(client.get_messages()))
            if answer.address == "/pulsetrain/late":
                break
        self.assertEqual(answer.address, "/pulsetrain/late")
        by_s = next(iter(answer))
        self.assertGreater(by_s, 0)
        live.stdin.write("stop\n")
        live.stdin.flush()
        live.stdout.read()
        self.assertEqual(live.wait(), 0)
        log = [json.loads(line) for line in (Path(folder.name) / "m.jsonl").read_text().splitlines()[1:]]
        sets = [line["done"] for line in log if line.get("done", {}).get("event") == "set"]
        self.assertEqual([done["knob"] for done in sets[:4]], ["a.swing", "b.frequency"] * 2)
        self.assertEqual(sets[0]["from_s"], sets[1]["from_s"])
        self.assertEqual(sets[2]["from_s"], sets[3]["from_s"])
        self.assertIsNotNone(sets[3]["ceiling"])
        # Both are on the same clock.
        self.assertAlmostEqual(sets[2]["from_s"] - sets[0]["from_s"], 1.25, delta=0.002)
        replayed = subprocess.run(
            [program() or "", "replay", "m.jsonl"], cwd=folder.name, stdout=subprocess.PIPE, text=True, check=False
        )
        self.assertIn("PASS", replayed.stdout)


if __name__ == "__main__":
    unittest.main()
