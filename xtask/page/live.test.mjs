// A live motion on the virtual Uno, steered in Chromium: `cargo xtask page` runs this. PULSETRAIN is the program; with
// SCREENSHOTS, a folder, pictures are written there.
import assert from "node:assert/strict";
import { spawn } from "node:child_process";
import { once } from "node:events";
import { mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { createInterface } from "node:readline";
import { after, before, test } from "node:test";
import puppeteer from "puppeteer-core";

const { PULSETRAIN, SCREENSHOTS, CHROMIUM = "/usr/bin/chromium" } = process.env;

/** Steps of the shaft to one side and back. */
const SWING = 60;
const TICK_HZ = 16e6;
/** Each step may be the tolerance of 1 µs off its law, and an edge up to 12 ticks late: twice both for a period. */
const LATEST_TICKS = 2 * (16 + 12);

const MOTION = `
board = "uno"
tolerance = "1 us"
[motor.wheel]
steps_per_rev = 200
driver = "A4988"
pulse_high = "2 us"
pins = { step = 8, dir = 9 }
forward = "high"
max_speed = "10 rev/s"
max_acceleration = "60 rev/s^2"
[[motion]]
motor = "wheel"
law.sweep = { frequency = "1 Hz", swing = "${SWING} step" }
[live.knobs]
rate = { target = "wheel.frequency", least = "0.5 Hz", greatest = "2 Hz" }
size = { target = "wheel.swing", least = "20 step", greatest = "120 step" }
[[cue]]
name = "slow"
set = { "wheel.frequency" = "0.5 Hz" }
`;

const folder = mkdtempSync(join(tmpdir(), "pulsetrain-page-"));
let run, url, browser;

before(async () => {
  writeFileSync(join(folder, "wheel.toml"), MOTION);
  const args = ["live", "wheel.toml", "--quiet", "--page", "127.0.0.1:0", "--trace", "wheel.vcd", "--log", "wheel.jsonl"];
  const env = { ...process.env, XDG_RUNTIME_DIR: folder };
  run = spawn(PULSETRAIN, args, { cwd: folder, env, stdio: ["pipe", "pipe", "inherit"] });
  const lines = createInterface({ input: run.stdout });
  [url] = await once(lines, "line");
  url = url.replace("the page: ", "");
  browser = await puppeteer.launch({ executablePath: CHROMIUM, protocolTimeout: 60_000, args: ["--no-sandbox"] });
});

after(async () => {
  await browser?.close();
  run?.kill();
  rmSync(folder, { recursive: true, force: true });
});

const POLLING = { polling: 50, timeout: 60_000 };
const says = (page, selector, text) =>
  page.waitForFunction((selector, text) => document.querySelector(selector)?.textContent.includes(text), POLLING, selector, text);
/** Waits until the motion is so many seconds further. */
async function pass(page, seconds) {
  const now = await page.evaluate("state.status.at_s");
  await page.waitForFunction((until) => state.status.at_s >= until, POLLING, now + seconds);
}

/** The ticks of a line's rising edges, by its name in a VCD file. */
function rising(text, name) {
  const [head, body] = text.split("$enddefinitions $end");
  const units = { ps: 1e-12, ns: 1e-9, us: 1e-6 };
  const [, number, unit] = head.match(/\$timescale (\d+) (\w+) \$end/);
  const of = head.match(new RegExp(`\\$var wire 1 (\\S+) ${name} \\$end`))[1];
  const ticks = Number(number) * units[unit] * TICK_HZ;
  const edges = [];
  let time = 0;
  for (const line of body.split("\n")) {
    if (line.startsWith("#")) time = Number(line.slice(1));
    else if (line === `1${of}` && time > 0) edges.push(time * ticks);
  }
  return edges;
}

/** The events of a kind in the run's log. */
function logged(kind) {
  const lines = readFileSync(join(folder, "wheel.jsonl"), "utf8").trim().split("\n").slice(1).map((line) => JSON.parse(line));
  return lines.map((line) => line.done).filter((done) => done?.event === kind);
}

test("a knob that is turned in the page changes the edges on the virtual Uno's pins as told", async () => {
  const page = await browser.newPage();
  await page.setViewport({ width: 1280, height: 900 });
  await page.goto(url);
  await says(page, "#link", "connected");
  await says(page, "#take", "Take control");
  await page.click("#take");
  await says(page, "#control-text", "you control");
  await page.waitForFunction("state.status?.at_s > 2", POLLING);
  // By keyboard: to the knob's greatest value.
  await page.focus("#knob-0");
  await page.keyboard.press("End");
  await says(page, "#events", "rate = 2 Hz");
  await pass(page, 4);
  // By pointer: near the middle.
  const slider = await (await page.$("#knob-0")).boundingBox();
  await page.mouse.click(slider.x + 0.4 * slider.width, slider.y + slider.height / 2);
  await page.waitForFunction(() => document.querySelectorAll("#events li").length >= 2, POLLING);
  await pass(page, 5);
  if (SCREENSHOTS) await page.screenshot({ path: join(SCREENSHOTS, "live-uno.png"), fullPage: true });
  const verdict = await page.$eval("#verdict", (verdict) => verdict.textContent);
  // By its key, from wherever the focus is but in text.
  await page.focus("#go-on");
  await page.keyboard.press("Space");
  await says(page, "#phase", "over");
  await page.close();
  if (run.exitCode === null) await once(run, "exit");
  assert.equal(run.exitCode, 0);
  assert.match(verdict, /PASS/);

  const sets = logged("set");
  const [stopping] = logged("stopping");
  assert.ok(sets.length >= 2, JSON.stringify(sets));
  assert.equal(sets[0].value, 2);
  assert.ok(sets.at(-1).value > 0.8 && sets.at(-1).value < 1.5, `${sets.at(-1).value} Hz at 0.4 of 0.5 to 2 Hz`);
  const edges = rising(readFileSync(join(folder, "wheel.vcd"), "utf8"), "step");
  // The old law, and each new one, from when it is followed to when it is left.
  const spans = [{ hz: 1, from_s: 0.1, to_s: sets[0].from_s }];
  sets.forEach((set, index) => spans.push({ hz: set.value, from_s: set.until_s, to_s: sets[index + 1]?.from_s ?? stopping.at_s }));
  const checked = spans.map(({ hz, from_s, to_s }) => {
    const own = edges.filter((tick) => tick > from_s * TICK_HZ && tick < to_s * TICK_HZ);
    const period = TICK_HZ / hz;
    // A period later the shaft makes the same step.
    const periods = own.slice(2 * SWING).map((tick, index) => tick - own[index]);
    const late = periods.map((ticks) => Math.abs(ticks - period));
    if (periods.length === 0) return 0;
    assert.ok(Math.max(...late) <= LATEST_TICKS, `${hz} Hz: a period of ${period} ticks is ${Math.max(...late)} off`);
    const mean = periods.reduce((sum, ticks) => sum + ticks, 0) / periods.length;
    assert.ok(Math.abs(mean - period) < 1, `${hz} Hz: a period is ${mean} ticks, and is to be ${period}`);
    return periods.length;
  });
  // Values that a drag went through may have been followed for less than a period.
  assert.ok(checked[0] > 50 && checked[1] > 300 && checked.at(-1) > 100, `periods that were looked at: ${checked}`);
});
