"""`pulsetrain film` on clips that are rendered here: what is lost must be found, what is not must not.

``python3 -m unittest tests.test_film`` in python; `cargo xtask test` does it with all that it needs.
"""

import importlib.util
import json
import math
import os
import re
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path
from typing import Any, Callable, List, Tuple

import numpy as np

from .clips import HAS_FFMPEG, Clip, Spot, errors_deg, follow
from .virtual import long, pulsetrain

ROOT = Path(__file__).resolve().parents[2]
HAS_TRACKER = HAS_FFMPEG and all(importlib.util.find_spec(name) for name in ("cv2", "av"))
needs_tracker = unittest.skipUnless(HAS_TRACKER, "needs ffmpeg, opencv-python-headless and av")
needs_program = unittest.skipUnless(
    HAS_TRACKER and pulsetrain(), "needs ffmpeg, opencv-python-headless, av, and pulsetrain: cargo build, or PULSETRAIN=…"
)

BLACK = Spot((30, 30, 30))
STEP_DEG = 360.0 / 800

#: 1 rev there and back in 1 s: 800 steps each way.
LAW = """board = "native"

[motor.wheel]
steps_per_rev = 200
microsteps = 4
driver = "DQ542MA"
pins = { step = 8, dir = 9 }
forward = "high"

[[motion]]
motor = "wheel"
law.sine = { amplitude = "0.5 rev", period = "1 s", cycles = 1 }
"""
START_S = 0.1


def sine(turns: float = 1.0, period_s: float = 1.0, start_s: float = 0.0) -> Callable[[float], float]:
    """`turns` there and back, from rest to rest, rad."""

    def theta(t: float) -> float:
        phase = min(max((t - start_s) / period_s, 0.0), 1.0)
        return math.pi * turns * (1.0 - math.cos(2.0 * math.pi * phase))

    return theta


def wheel(lost: Tuple[Tuple[float, int], ...] = ()) -> Callable[[float], float]:
    """The motion of LAW, which starts at START_S of the film, in steps, less what is lost: (law time, steps)."""
    theta = sine(start_s=START_S)

    def stepped(t: float) -> float:
        steps = round(math.degrees(theta(t)) / STEP_DEG)
        steps -= sum(count for at, count in lost if t - START_S >= at)
        return math.radians(steps * STEP_DEG)

    return stepped


@needs_tracker
class Angles(unittest.TestCase):
    """The tracker against the angles that were rendered."""

    folder: "tempfile.TemporaryDirectory[str]"

    @classmethod
    def setUpClass(cls) -> None:
        cls.folder = tempfile.TemporaryDirectory()

    @classmethod
    def tearDownClass(cls) -> None:
        cls.folder.cleanup()

    def found(self, clip: Clip, **settings: Any) -> Tuple[Any, float, float]:
        """The track, the rms error, degrees, and the rms of error/σ."""
        video = clip.write(Path(self.folder.name) / "clip.mp4")
        track = follow(video, sys.executable, exposure_s=clip.shutter / clip.fps, **settings)
        off, sigma = errors_deg(clip, track)
        return track, float(off.std()), float(np.sqrt(np.mean((off / sigma) ** 2)))

    def check(self, clip: Clip, most_deg: float, **settings: Any) -> Any:
        track, rms, by_sigma = self.found(clip, **settings)
        self.assertLess(rms, most_deg)
        # What is stated is neither a wish nor a fright.
        self.assertLess(by_sigma, 3.0)
        self.assertGreater(by_sigma, 0.2)
        return track

    def test_a_sharp_clip(self) -> None:
        self.check(Clip(sine(), crf=8), 0.05)

    def test_blur_and_noise(self) -> None:
        self.check(Clip(sine(), shutter=0.5, noise=6.0, crf=28), 0.2)

    @long
    def test_a_long_exposure_smears_marks(self) -> None:
        self.check(Clip(sine(3.0), shutter=0.9, noise=3.0, exposures=20), 0.25)

    def test_an_oblique_view(self) -> None:
        track = self.check(Clip(sine(), tilt_deg=(25.0, -20.0), noise=3.0), 0.1)
        self.assertGreater(track["tilt_deg"], 12.0)

    def test_four_marks_on_the_frame(self) -> None:
        """A turn that is too small to show the view by itself."""
        clip = Clip(sine(0.08), tilt_deg=(20.0, -25.0), distance=9.0, noise=2.0, frame=(1.2, 1.0), seconds=0.8)
        track = self.check(clip, 0.08, frame=[1.2, 1.0])
        self.assertTrue(track["frame_used"])

    @long
    def test_a_camera_in_a_hand(self) -> None:
        track = self.check(Clip(sine(), noise=2.0, shake_px=1.5, frame=(1.2, 1.05), seconds=0.7), 0.1, frame=[1.2, 1.05])
        self.assertGreater(track["shake_px"], 0.5)

    def test_a_rolling_shutter(self) -> None:
        track = self.check(Clip(sine(2.0), readout_s=0.006, noise=2.0), 0.1)
        self.assertAlmostEqual(track["readout_s"], 0.006, delta=0.0003)
        self.check(Clip(sine(2.0), readout_s=0.006, noise=2.0), 0.1, readout_s=0.006)

    @long
    def test_frames_are_missing(self) -> None:
        track = self.check(Clip(sine(), noise=2.0, dropped=(30, 31, 60, 61, 62)), 0.1)
        self.assertEqual(track["in_clip"], 115)
        self.assertAlmostEqual(track["longest_gap_s"], 4 / 120, places=4)

    @long
    def test_time_stamps_are_the_clips(self) -> None:
        """Frames at odd times, and a header that has another rate."""
        # From 0 on: an MP4's file has its first frame's time in whole milliseconds.
        times = [i / 120 + 0.003 * math.sin(i) for i in range(110)]
        track = self.check(Clip(sine(), noise=2.0, times=times), 0.1)
        self.assertAlmostEqual(track["frames"][50][0], times[50], delta=2e-4)
        raw = Clip(sine(period_s=0.8), noise=2.0, said_fps=25.0, seconds=0.9)
        self.check(raw, 0.1)

    @long
    def test_frames_that_repeat_the_one_before(self) -> None:
        track = self.check(Clip(sine(), noise=3.0, repeated=(30, 50, 70)), 0.1)
        self.assertEqual(track["repeated"], 3)

    @long
    def test_one_mark_is_hidden_for_a_while(self) -> None:
        track = self.check(Clip(sine(), noise=2.0, hidden=range(40, 50)), 0.12)
        self.assertEqual((track["one_mark"], track["lost"]), (10, 0))

    @long
    def test_slow_motion(self) -> None:
        clip = Clip(sine(), noise=2.0, slow=8.0)
        self.check(clip, 0.1, slow=8.0)

    @long
    def test_marks_of_many_kinds(self) -> None:
        white, black_wheel = (240, 240, 240), {"wheel_bgr": (20, 20, 20), "behind_bgr": (200, 200, 200)}
        kinds: List[Tuple[str, Any]] = [
            ("alike", {"marks": (BLACK, Spot(BLACK.bgr, angle_deg=180.0))}),
            ("alike, not opposite", {"marks": (BLACK, Spot(BLACK.bgr, at=0.5, angle_deg=120.0))}),
            ("large and small", {"marks": (Spot(BLACK.bgr, radius=0.13), Spot(BLACK.bgr, angle_deg=180.0, radius=0.07))}),
            ("on black", {"marks": (Spot(white, radius=0.12), Spot(white, angle_deg=180.0, radius=0.07)), **black_wheel}),
            ("green and yellow", {"marks": (Spot((60, 160, 40)), Spot((40, 220, 230), angle_deg=150.0, at=0.6))}),
        ]
        for name, looks in kinds:
            with self.subTest(name):
                self.check(Clip(sine(), noise=2.0, seconds=0.8, **looks), 0.1)

    @long
    def test_marks_are_named(self) -> None:
        red, blue, green = Spot((40, 40, 220)), Spot((220, 90, 30), angle_deg=180.0), Spot((60, 160, 40), angle_deg=80.0)
        clip = Clip(sine(), noise=2.0, seconds=0.6, marks=(red, blue, green))
        track = self.check(clip, 0.1, marks=[[40, 40, 210], [60, 170, 50]])
        self.assertEqual(sorted(mark["colour"] for mark in track["marks"]), ["green", "red"])
        at = [track["marks"][k] for k in (0, 1)]
        self.check(clip, 0.1, marks=[[mark["x"], mark["y"]] for mark in at])

    def test_what_cannot_be_tracked_is_said(self) -> None:
        bare = Clip(sine(), noise=2.0, seconds=0.3, marks=())
        one = Clip(sine(), noise=2.0, seconds=0.5, marks=(Spot((40, 40, 220)),))
        short = Clip(sine(), seconds=0.05)
        for clip, text in ((bare, "no marks that move"), (one, "no two marks"), (short, "at least 8 are needed")):
            with self.assertRaisesRegex(LookupError, text):
                self.found(clip)
        nonsense = Path(self.folder.name) / "nonsense.mp4"
        nonsense.write_bytes(b"no video at all" * 100)
        with self.assertRaisesRegex(LookupError, "cannot read"):
            follow(nonsense, sys.executable)


@needs_program
class Verdicts(unittest.TestCase):
    """The program on whole clips."""

    def setUp(self) -> None:
        self.folder = tempfile.TemporaryDirectory()
        self.addCleanup(self.folder.cleanup)
        self.path = Path(self.folder.name)
        (self.path / "wheel.toml").write_text(LAW)

    def run_program(self, *words: str, **environment: str) -> Tuple[int, str, str]:
        env = {**os.environ, "PULSETRAIN_PYTHON": sys.executable, **environment}
        command = [str(Path(pulsetrain() or "").resolve()), *words]
        ran = subprocess.run(command, cwd=self.path, env=env, capture_output=True, text=True)
        return ran.returncode, ran.stdout, ran.stderr

    def judged(self, clip: Clip, *words: str) -> Tuple[int, str]:
        clip.write(self.path / "clip.mp4")
        code, out, err = self.run_program("film", "clip.mp4", "wheel.toml", *words)
        return code, out + err

    def clip(self, lost: Tuple[Tuple[float, int], ...] = (), **looks: Any) -> Clip:
        return Clip(wheel(lost), **{"seconds": 1.25, "shutter": 0.4, "noise": 3.0, "crf": 20, **looks})

    def test_a_wheel_that_follows_passes(self) -> None:
        code, text = self.judged(self.clip())
        self.assertEqual(code, 0, text)
        self.assertIn("PASS: no bound broke", text)
        for name in ("track.csv", "film.svg", "marks.png", "report.json"):
            self.assertGreater((self.path / "out/clip" / name).stat().st_size, 500, name)
        verdict = json.loads((self.path / "out/clip/report.json").read_text())["verdict"]
        self.assertAlmostEqual(verdict["alignment"]["shift_s"], START_S, delta=0.003)
        # The same track by hand.
        code, out, err = self.run_program("verify", "out/clip/track.csv", "wheel.toml", "--plot", "again.svg")
        self.assertEqual(code, 0, out + err)
        self.assertIn("PASS", out)
        self.assertTrue((self.path / "again.svg").exists())

    def lost_steps_are_found(self, **looks: Any) -> None:
        code, text = self.judged(self.clip(lost=((0.3, 8),), **looks))
        self.assertEqual(code, 1, text)
        self.assertRegex(text, r"FAIL: 8 steps lost at 0\.(29|30|31) s")

    def test_lost_steps_are_found(self) -> None:
        self.lost_steps_are_found()

    @long
    def test_lost_steps_are_found_however_it_is_filmed(self) -> None:
        for looks in ({"tilt_deg": (20.0, -15.0)}, {"readout_s": 0.005}, {"dropped": (50, 51, 80)}):
            with self.subTest(looks):
                self.lost_steps_are_found(**looks)

    @long
    def test_fewer_steps_than_the_limit_are_found_too(self) -> None:
        code, text = self.judged(self.clip(lost=((0.25, 1),)), "--limit", "5 deg")
        self.assertEqual(code, 1, text)
        self.assertRegex(text, r"FAIL: 1 step lost at 0\.2\d s")

    def test_another_motion_fails(self) -> None:
        (self.path / "wheel.toml").write_text(LAW.replace("0.5 rev", "0.45 rev"))
        code, text = self.judged(self.clip())
        self.assertEqual(code, 1, text)
        self.assertIn("FAIL: the wheel is off by more than 1.000°", text)

    @long
    def test_from_behind(self) -> None:
        clip = Clip(lambda t: -wheel()(t) + 1.0, seconds=1.25, noise=3.0)
        code, text = self.judged(clip)
        self.assertEqual(code, 0, text)
        self.assertIn("the other way round", text)

    @long
    def test_the_limit_is_the_files_or_the_commands(self) -> None:
        (self.path / "wheel.toml").write_text(LAW.replace("0.5 rev", "0.49 rev"))
        self.assertEqual(self.judged(self.clip())[0], 1)
        self.assertEqual(self.run_program("film", "clip.mp4", "wheel.toml", "--limit", "10 deg")[0], 0)
        text = (self.path / "wheel.toml").read_text().replace('forward = "high"', 'forward = "high"\nfilm_limit = "10 deg"')
        (self.path / "wheel.toml").write_text(text)
        self.assertEqual(self.run_program("film", "clip.mp4", "wheel.toml")[0], 0)

    @long
    def test_slow_motion_is_noticed(self) -> None:
        code, text = self.judged(self.clip(slow=8.0))
        self.assertEqual(code, 1, text)
        self.assertIn("say --slow 8", text)
        code, out, err = self.run_program("film", "clip.mp4", "wheel.toml", "--slow", "8")
        self.assertEqual(code, 0, out + err)

    def test_what_is_missing_is_named_with_its_command(self) -> None:
        (self.path / "clip.mp4").write_bytes(b"")
        bin_folder = self.path / "bin"
        bin_folder.mkdir()
        home = {"HOME": str(self.path), "XDG_DATA_HOME": "", "PULSETRAIN_PYTHON": "", "PATH": str(bin_folder)}
        code, _, err = self.run_program("film", "clip.mp4", "wheel.toml", **home)
        self.assertEqual(code, 2)
        self.assertIn("Python 3 is missing", err)
        # A Python without packages.
        python = bin_folder / "python3"
        python.write_text(f'#!/bin/sh\nexec "{sys.executable}" -S -I "$@"\n')
        python.chmod(0o755)
        code, _, err = self.run_program("film", "clip.mp4", "wheel.toml", **home)
        self.assertEqual(code, 2)
        self.assertIn("python3 -m venv ~/.local/share/pulsetrain/python\n", err)
        self.assertIn("~/.local/share/pulsetrain/python/bin/pip install opencv-python-headless av\n", err)

    def test_the_page_about_films_holds(self) -> None:
        """A new user's own film, with the commands of docs/film.md alone."""
        page = (ROOT / "docs/film.md").read_text()
        (self.path / "wheel.toml").write_text(re.search(r"```toml\n(.*?)```", page, re.S).group(1))  # type: ignore[union-attr]
        commands = re.findall(r"^\$ pulsetrain (film .*)$", page, re.M)
        self.assertTrue(commands)
        Clip(wheel(), seconds=1.25, noise=3.0, shutter=0.3).write(self.path / "clip.mp4")
        code, out, err = self.run_program(*commands[0].split())
        self.assertEqual(code, 0, out + err)
        self.assertIn("PASS", out)


if __name__ == "__main__":
    unittest.main()
