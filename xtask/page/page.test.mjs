// The page in Chromium: `cargo xtask page` runs this. PAGE is a program that serves a page and prints its address; with
// SCREENSHOTS, a folder, pictures are written there.
import assert from "node:assert/strict";
import { spawn } from "node:child_process";
import { once } from "node:events";
import http from "node:http";
import { join } from "node:path";
import { createInterface } from "node:readline";
import { after, before, test } from "node:test";
import puppeteer from "puppeteer-core";

const { PAGE, SCREENSHOTS, CHROMIUM = "/usr/bin/chromium" } = process.env;

let run, url, browser;
const started = [];

/** A new run with its page. */
async function start() {
  const child = spawn(PAGE, ["0"], { stdio: ["ignore", "pipe", "inherit"] });
  started.push(child);
  const [address] = await once(createInterface({ input: child.stdout }), "line");
  return { child, address };
}

before(async () => {
  ({ child: run, address: url } = await start());
  browser = await puppeteer.launch({
    executablePath: CHROMIUM,
    protocolTimeout: 30_000,
    // Everything in it comes from this computer. A name of somebody else leads here, as a trick with DNS would.
    args: ["--no-sandbox", "--host-resolver-rules=MAP evil.example 127.0.0.1"],
  });
});

after(async () => {
  await browser?.close();
  started.forEach((child) => child.kill());
});

const PHONE = { width: 390, height: 844, deviceScaleFactor: 2, isMobile: true, hasTouch: true };
const DESKTOP = { width: 1280, height: 900 };

/** A page that has the run's lines. Whatever its console complains of fails the test. */
async function open(address = url, viewport = DESKTOP, scheme = "light") {
  const page = await browser.newPage();
  page.complaints = [];
  page.on("console", (message) => {
    if (message.type() === "error") page.complaints.push(message.text());
  });
  page.on("pageerror", (error) => page.complaints.push(String(error)));
  await page.setViewport(viewport);
  await page.emulateMediaFeatures([{ name: "prefers-color-scheme", value: scheme }]);
  await page.goto(address);
  await says(page, "#link", "connected");
  await page.waitForFunction(() => document.querySelector(".position span")?.textContent !== "–", POLLING);
  return page;
}

/** Pages behind others draw nothing, so it is asked for now and then instead of at each frame. */
const POLLING = { polling: 50, timeout: 30_000 };
const says = (page, selector, text) =>
  page.waitForFunction((selector, text) => document.querySelector(selector)?.textContent.includes(text), POLLING, selector, text);
const told = (page, text) => says(page, "#events", text);

/** A real click needs the page in front. */
async function click(page, selector) {
  await page.bringToFront();
  await page.click(selector);
}

async function takeControl(page) {
  await says(page, "#take", "Take control");
  await click(page, "#take");
  await says(page, "#control-text", "you control");
}

async function picture(page, name) {
  if (SCREENSHOTS) await page.screenshot({ path: join(SCREENSHOTS, `${name}.png`), fullPage: name.includes("full") });
}

test("knobs, cues, tempo and pause reach the run, and one page controls", async () => {
  const [one, other] = [await open(), await open()];
  assert.equal(await one.$eval("#go-on", (button) => button.disabled), true, "nobody controls yet");
  assert.equal(await one.$eval("#stop", (button) => button.disabled), false, "all may stop");
  await takeControl(one);
  await says(other, "#control-text", "another page controls");
  // A knob by keyboard.
  await one.bringToFront();
  await one.focus("#knob-0");
  await one.keyboard.press("ArrowRight");
  await told(one, "x.amplitude = 30.06 mm");
  await other.waitForFunction(() => Number(document.querySelector("#knob-0").value) === 30.06, POLLING);
  // A value that the motors cannot follow.
  await one.focus("#knob-1");
  await one.keyboard.press("End");
  await says(one, "#knobs", "The nearest that the motors follow: y: max_speed");
  await click(one, "#go");
  await told(one, "Cue noon");
  await click(one, '#tempo-presets [data-rate="0.5"]');
  await told(one, "Tempo 0.5×");
  await told(other, "Tempo 0.5×");
  await click(one, "#go-on");
  await says(one, "#phase", "paused");
  await click(one, "#go-on");
  await says(one, "#phase", "running");
  // Text with a unit is sent as it is.
  await one.type("#position", "90 deg\n");
  await told(one, "Go to 90 deg");
  await takeControl(other);
  await says(one, "#control-text", "another page controls");
  assert.deepEqual([...one.complaints, ...other.complaints], []);
  await Promise.all([one.close(), other.close()]);
});

test("an error in the motion file is shown at its place", async () => {
  const page = await open();
  await takeControl(page);
  await page.waitForFunction(() => document.querySelector("#text").value.includes("30 mm"), POLLING);
  const text = await page.$eval("#text", (text) => text.value);
  const line = text.split("\n").findIndex((line) => line.includes('amplitude = "30 mm"')) + 1;
  await page.$eval("#text", (text) => {
    text.value = text.value.replace('amplitude = "30 mm"', 'amplitude = "30 parrots"');
    text.dispatchEvent(new Event("input", { bubbles: true }));
  });
  await click(page, "#take-over");
  await says(page, "#text-says", `Line ${line}, column `);
  assert.equal(await page.$eval("#gutter b", (mark) => mark.textContent), String(line));
  const chosen = await page.$eval("#text", (text) => text.value.slice(text.selectionStart, text.selectionEnd));
  assert.match(chosen, /^parrots/);
  await picture(page, "desktop-light-error");
  await page.$eval("#text", (field, text) => {
    field.value = text.replace('"30 mm"', '"20 mm"');
    field.dispatchEvent(new Event("input", { bubbles: true }));
  }, text);
  await click(page, "#take-over");
  await says(page, "#text-says", "The motors follow this text now");
  assert.deepEqual(page.complaints, []);
  await page.close();
});

test("a page that comes later has the history", async () => {
  const page = await open();
  // The first statuses of the run, long before this page.
  await page.waitForFunction("history_.at.length > 20 && history_.at[0] < 0.2", POLLING);
  await told(page, "Cue noon");
  await page.close();
});

test("it fits a phone, has names for all it has, and shows dark and light", async () => {
  for (const [name, viewport] of [["desktop", DESKTOP], ["phone", PHONE]]) {
    for (const scheme of ["light", "dark"]) {
      const page = await open(url, viewport, scheme);
      await takeControl(page);
      await page.waitForFunction("history_.at.length > 100", POLLING);
      const { wide, stop, nameless } = await page.evaluate(() => {
        const { top, bottom, left, right } = document.querySelector("#stop").getBoundingClientRect();
        const isNamed = (element) => element.textContent.trim() || element.ariaLabel || element.labels?.length || element.closest("[role=img]");
        const all = [...document.querySelectorAll("button, input, textarea, a, canvas")];
        return {
          wide: document.documentElement.scrollWidth - innerWidth,
          stop: top >= 0 && bottom <= innerHeight && left >= 0 && right <= innerWidth,
          nameless: all.filter((element) => !isNamed(element)).map((element) => element.outerHTML),
        };
      });
      assert.ok(wide <= 0, `${name}: ${wide} px too wide`);
      assert.ok(stop, `${name}: the stop button is always there`);
      assert.deepEqual(nameless, []);
      await picture(page, `${name}-${scheme}`);
      await picture(page, `${name}-${scheme}-full`);
      if (name === "desktop") {
        await click(page, '[data-quantity="share"]');
        await page.waitForFunction("!state.mustDraw", { polling: "raf" });
        await picture(page, `${name}-${scheme}-share`);
      }
      assert.deepEqual(page.complaints, []);
      await page.close();
    }
  }
});

test("a page of another origin, and a name that leads here, get nothing", async () => {
  const evil = http.createServer((_, answer) => answer.setHeader("Content-Type", "text/html").end("<h1>Another site</h1>"));
  await new Promise((done) => evil.listen(0, "127.0.0.1", done));
  const page = await browser.newPage();
  await page.goto(`http://127.0.0.1:${evil.address().port}/`);
  const { host } = new URL(url);
  const got = await page.evaluate(async (host) => {
    const socket = await new Promise((done) => {
      const socket = new WebSocket(`ws://${host}/socket`);
      socket.onopen = () => done("open");
      socket.onerror = () => done("refused");
    });
    const read = await fetch(`http://${host}/motion.toml`).then(() => "read", () => "refused");
    const blind = await fetch(`http://${host}/motion.toml`, { mode: "no-cors" }).then((answer) => answer.type, () => "refused");
    const posted = await fetch(`http://${host}/socket`, { method: "POST", body: '{"command":"stop"}' }).then(() => "read", () => "refused");
    const script = await new Promise((done) => {
      const script = document.createElement("script");
      script.src = `http://${host}/page.js`;
      script.onload = () => done("loaded");
      script.onerror = () => done("refused");
      document.head.append(script);
    });
    return { socket, read, blind, posted, script };
  }, host);
  assert.deepEqual(got, { socket: "refused", read: "refused", blind: "refused", posted: "refused", script: "refused" });
  // In a frame it is not shown.
  await page.evaluate((url) => {
    const frame = document.createElement("iframe");
    frame.src = url;
    document.body.append(frame);
    return new Promise((done) => (frame.onload = done));
  }, url);
  const inside = await Promise.all(page.frames().map((frame) => frame.evaluate(() => Boolean(document.querySelector("#stop")))));
  assert.deepEqual(inside, [false, false]);
  const tricked = await page.goto(`http://evil.example:${new URL(url).port}/`);
  assert.equal(tricked.status(), 421);
  assert.equal(run.exitCode, null, "the run goes on");
  await page.close();
  evil.close();
});

test("the space bar stops, wherever the focus is but in text", async () => {
  const { child, address } = await start();
  const page = await open(address, PHONE);
  await page.focus("#position").catch(() => {});
  await takeControl(page);
  // In text a space is a space.
  await page.type("#position", "1 mm");
  assert.equal(await page.$eval("#position", (field) => field.value), "1 mm");
  assert.equal(await page.$eval("#phase", (phase) => phase.textContent), "running");
  await click(page, "#take");
  await says(page, "#control-text", "no page controls");
  // The button that has the focus is not pressed.
  await page.focus("#take");
  await page.keyboard.press("Space");
  await told(page, "Stop: the motors brake");
  await says(page, "#phase", "over");
  await says(page, "#alert", "The motion was stopped");
  await picture(page, "phone-light-over");
  await told(page, "The motion was stopped");
  assert.equal(await page.$eval("#control-text", (text) => text.textContent), "");
  if (child.exitCode === null) await once(child, "exit");
  assert.equal(child.exitCode, 0);
  await page.close();
});

test("a page that has lost the run says that it cannot stop it", async () => {
  const { child, address } = await start();
  const page = await open(address, PHONE, "dark");
  child.kill("SIGKILL");
  await says(page, "#alert", "this page cannot stop the motors");
  assert.equal(await page.$eval("#stop", (button) => button.disabled), true);
  await picture(page, "phone-dark-lost");
  await page.close();
});
