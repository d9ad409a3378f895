"use strict";
// The page of a motion: it speaks the lines of the control socket (docs/control.md) over a WebSocket.

const $ = (id) => document.getElementById(id);

/** A new element with text and attributes. */
function make(name, attributes = {}, ...children) {
  const element = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  element.append(...children);
  return element;
}

const history_ = new History();
const state = {
  socket: null,
  info: null,
  control: { yours: false, taken: false, pages: 0 },
  /** waiting, running, pausing, paused, resuming, stopping, ended */
  phase: "waiting",
  stopAskedAt: null,
  status: null,
  latestHistory_s: -Infinity,
  rate: 1,
  cue: null,
  worst_steps: 0,
  refused: 0,
  rejoined: 0,
  failed: false,
  quantity: "position",
  span_s: 20,
  plots: [],
  figure: null,
  rows: [],
  isDirty: false,
  fileText: "",
  drawnAt: 0,
  mustDraw: false,
  retry_ms: 500,
};

// ---------- the line to the server

// The token came with the address; from now on a cookie has it.
if (location.search) window.history.replaceState(null, "", location.pathname);

function connect() {
  const socket = new WebSocket(`ws://${location.host}/socket`);
  state.socket = socket;
  socket.onopen = () => (state.retry_ms = 500);
  socket.onmessage = ({ data }) => hear(JSON.parse(data));
  socket.onclose = ({ code, reason }) => {
    if (state.socket !== socket) return;
    state.socket = null;
    // Normal: the run has ended, and says so itself.
    if (reason && code !== 1000) tell(`The run disconnected this page: ${reason}`, { bad: true });
    state.control = { yours: false, taken: false, pages: 0 };
    showLink();
    if (state.phase === "ended") return;
    setTimeout(connect, state.retry_ms);
    state.retry_ms = Math.min(state.retry_ms * 2, 5000);
  };
}

function send(line) {
  if (state.socket?.readyState === WebSocket.OPEN) state.socket.send(JSON.stringify(line));
}

const command = (name, more = {}) => send({ command: name, ...more });

function hear(line) {
  if ("pulsetrain_control" in line) return meet(line);
  if (line.history) return recall(line.history);
  if (line.past) {
    $("log").hidden = !line.log;
    return line.past.forEach((event) => happen(event, true));
  }
  if (line.control) return showControl(line.control);
  if (line.event === "status") return follow(line);
  if (line.error && !line.event) return tell(line.error, { bad: true });
  happen(line, false);
}

/** The first line, and again when knobs or cues have changed. */
function meet(info) {
  const isNew = state.info?.name !== info.name || state.info.motors.length !== info.motors.length;
  const before = state.info;
  state.info = info;
  const file = info.file.split(/[/\\]/).pop();
  document.title = `${file} – Pulsetrain`;
  $("file").textContent = file;
  $("file").title = info.file;
  $("board").textContent = info.port ? `${info.board} at ${info.port}` : info.name.startsWith("native") ? `${info.board}, native` : `virtual ${info.board}`;
  document.body.classList.toggle("live", info.is_live);
  $("text").readOnly = !info.is_live;
  // A new connection brings its own history.
  if (isNew || !state.linked) {
    history_.clear(info.motors.length);
    Object.assign(state, { latestHistory_s: -Infinity, worst_steps: 0, refused: 0, rejoined: 0, failed: false, cue: null, rate: 1, status: null });
    state.phase = "waiting";
    state.stopAskedAt = null;
    $("events").replaceChildren();
    loadText();
  }
  state.linked = true;
  if (isNew || JSON.stringify(before.motors) !== JSON.stringify(info.motors)) buildMotors();
  buildKnobs();
  buildCues();
  showLink();
  showPhase();
}

function recall({ at_s, position, target, speed }) {
  at_s.forEach((at, place) => {
    const motors = position.map((column, motor) => ({ position: column[place], target: target[motor][place], speed: speed[motor][place] }));
    history_.add(at, motors);
    judge(motors);
  });
  state.latestHistory_s = history_.latest;
  if (at_s.length && state.phase === "waiting") state.phase = "running";
  state.mustDraw = true;
}

function follow(status) {
  if (status.at_s <= state.latestHistory_s) return;
  state.status = status;
  history_.add(status.at_s, status.motors);
  judge(status.motors);
  // A status says that the motion has begun, and when a change of tempo is done.
  if (state.phase === "waiting" || (state.phase === "resuming" && status.at_s >= state.changes_s)) state.phase = "running";
  if (state.phase === "pausing" && status.at_s >= state.changes_s) state.phase = "paused";
  state.mustDraw = true;
}

function judge(motors) {
  for (const { position, target } of motors) {
    if (target !== null) state.worst_steps = Math.max(state.worst_steps, Math.abs(position - target));
  }
}

function happen(line, isPast) {
  const at = line.from_s ?? line.at_s ?? (isPast ? (line.rests_s ?? line.full_speed_s ?? null) : history_.latest);
  const until = line.until_s !== undefined ? `, done at ${clock(line.until_s)}` : "";
  const limit = line.ceiling ? `, the nearest that the motors follow: ${line.ceiling}` : "";
  if (line.ended) return end(line);
  switch (line.event) {
    case "pausing":
      [state.phase, state.changes_s] = ["pausing", line.rests_s];
      tell(`Pause: the motors rest from ${clock(line.rests_s)} on.`, { at });
      break;
    case "resuming":
      [state.phase, state.changes_s] = ["resuming", line.full_speed_s];
      tell(`It goes on, at full speed from ${clock(line.full_speed_s)} on.`, { at });
      break;
    case "tempo":
      state.rate = line.rate;
      showTempo();
      $("tempo-says").textContent = line.ceiling ? `The highest that the motors follow: ${line.ceiling}` : "";
      tell(`Tempo ${significant(line.rate, 3)}×${limit}.`, { at, limited: Boolean(line.ceiling) });
      break;
    case "stopping":
      state.phase = "stopping";
      state.stopAskedAt ??= performance.now();
      tell("Stop: the motors brake.", { at });
      break;
    case "stopped_at_once":
      state.phase = "stopping";
      tell(`Stopped at once.${line.uncertain.some(Boolean) ? " A fast motor may have turned further than it counted." : ""}`, { at, bad: line.uncertain.some(Boolean) });
      break;
    case "set":
      showKnob(line, isPast);
      tell(`${line.knob} = ${significant(line.value)} ${line.unit}${until}${limit}.`, { at, limited: Boolean(line.ceiling) });
      break;
    case "cue":
      state.cue = line.name;
      showCue();
      tell(`Cue ${line.name}${until}.`, { at });
      break;
    case "goto":
      tell(`Go to ${line.position}${until}.`, { at });
      break;
    case "motion":
      tell(`The changed motion file is taken over${until}.`, { at });
      if (!isPast) {
        textSays("The motors follow this text now.", "good");
        if (state.sentText === $("text").value) state.isDirty = false;
        loadText();
      }
      break;
    case "motion_refused":
      tell(`The changed motion file was refused: ${line.error.split("\n")[0]}`, { at, bad: true });
      if (!isPast) showError(line);
      break;
    case "rejoined":
      state.rejoined = line.times;
      tell(`The motors had braked, and join the motion again${until}.`, { at, bad: true });
      break;
    case "taken_back":
      tell(`The last change is taken back: ${line.why}. The motors had braked, and ${line.rests ? "rest where they stand" : `join the motion before that change${until}`}.`, { at, bad: true });
      break;
    case "late":
      // Its sender hears it.
      break;
    case "returned":
      tell(`The motors join the motion again${until}.`, { at });
      break;
    case "began":
      tell(`The motion begins${until}.`, { at });
      break;
    case "already_runs":
      tell("The motion already runs, and goes on.", { at });
      break;
    case "motion_ended":
      tell("The motion has ended, and the motors rest. To start it again, type begin at the terminal. A knob, a cue or the file changes it. Stop ends the session.", { at });
      break;
    case "resting":
      tell(line.until ? `It is not time: the motors rest. The motion begins on ${line.until}.` : "The motors rest.", { at });
      break;
    case "unplugged":
      tell(`The board cannot be reached: ${line.why}. The motors brake. The run waits for ${line.port}.`, { at, bad: true });
      break;
    case "unplaced":
      tell(`${line.why}: the position of ${line.motors.join(", ")} is not known. Write it where the run was started, such as: here 0 deg`, { at, bad: true });
      break;
    case "placed":
      tell(`${line.motors.join(", ")} at ${line.position}: noted.`, { at });
      break;
    case "refused":
      state.refused += 1;
      tell(`${inWords(line.command)} was refused: ${line.why}`, { at, bad: true });
      if (line.command.command === "motion" && !isPast) textSays(line.why, "bad");
      break;
    default:
      // An event of a later version.
      if (line.event) tell(JSON.stringify(line), { at });
  }
  showPhase();
  state.mustDraw = true;
}

function inWords({ command, knob, value, rate, name, position }) {
  return [command.replace("_", " "), knob, value, rate, name, position].filter((word) => word !== undefined).join(" ");
}

function end(line) {
  state.phase = "ended";
  state.failed = line.ended === "failed";
  const words = { finished: "The motion came to its end", stopped: "The motion was stopped", failed: "The motion failed" };
  const places = line.motors.map(({ name, position, unit }) => `${name} at ${significant(position)} ${unit}`).join(", ");
  const text = `${words[line.ended] ?? line.ended}${line.why ? `: ${line.why}` : ""}.${places ? ` The motors are where they stand: ${places}.` : ""}`;
  tell(text, { bad: state.failed });
  alarm(text, !state.failed);
  showPhase();
  showLink();
  state.mustDraw = true;
}

// ---------- what is shown

function alarm(text, isCalm = false) {
  $("alert").textContent = text;
  $("alert").hidden = !text;
  $("alert").classList.toggle("calm", isCalm);
}

function tell(text, { at = null, bad = false, limited = false } = {}) {
  const list = $("events");
  list.querySelector(".empty")?.remove();
  const item = make("li", bad || limited ? { class: bad ? "bad" : "limited" } : {}, make("time", {}, at === null ? "" : clock(at)), make("span", {}, text));
  list.prepend(item);
  while (list.children.length > 200) list.lastChild.remove();
}

function showLink() {
  const isOpen = state.socket?.readyState === WebSocket.OPEN;
  if (!isOpen) state.linked = false;
  document.body.classList.toggle("offline", !isOpen);
  const link = $("link");
  link.textContent = isOpen ? "connected" : "no connection";
  link.className = `chip ${isOpen ? "good" : "bad"}`;
  link.hidden = state.phase === "ended";
  // Without a connection nobody here knows.
  $("phase").hidden = !isOpen && state.phase !== "ended";
  if (state.phase !== "ended") {
    const lost = "No connection: this page cannot stop the motors. Press Ctrl-C where pulsetrain runs, or switch off the motors' supply.";
    alarm(isOpen || !state.info ? "" : lost);
  }
  showControl(state.control);
}

function showControl(control) {
  state.control = control;
  const isOpen = state.socket?.readyState === WebSocket.OPEN && state.phase !== "ended";
  const others = control.pages > 1 ? ` (${control.pages} pages)` : "";
  $("control-text").textContent = !isOpen ? "" : control.yours ? `you control${others}` : control.taken ? `another page controls${others}` : `no page controls${others}`;
  $("take").textContent = control.yours ? "Give back" : "Take control";
  $("take").classList.toggle("primary", !control.yours && isOpen);
  $("take").hidden = !isOpen;
  $("stop").disabled = !isOpen;
  const mayControl = isOpen && control.yours && state.phase !== "stopping";
  for (const element of document.querySelectorAll(".needs-control")) {
    element.disabled = !mayControl || (element.classList.contains("needs-live") && !state.info?.is_live);
  }
}

function showPhase() {
  const names = { waiting: "not begun", running: "running", pausing: "pausing", paused: "paused", resuming: "resuming", stopping: "stopping", ended: "over" };
  const kinds = { running: "good", stopping: "bad", paused: "warn", pausing: "warn" };
  $("phase").textContent = names[state.phase];
  $("phase").className = `chip ${kinds[state.phase] ?? ""}`;
  const goesOn = state.phase === "running" || state.phase === "resuming";
  $("go-on").textContent = goesOn ? "Pause" : state.phase === "waiting" ? "Start" : "Resume";
  const isAgain = state.phase === "stopping" || state.stopAskedAt !== null;
  $("stop").classList.toggle("again", isAgain && state.phase !== "ended");
  $("stop-name").textContent = isAgain && state.phase !== "ended" ? "STOP AT ONCE" : "STOP";
  showControl(state.control);
}

function showTempo() {
  if (document.activeElement !== $("tempo") || !$("tempo").matches(":active")) $("tempo").value = Math.log2(state.rate);
  $("tempo-now").textContent = `${significant(state.rate, 3)}×`;
}

function buildMotors() {
  state.plots.forEach((plot) => plot.destroy());
  state.plots = [];
  state.rows = state.info.motors.map((motor) => {
    const row = {
      position: make("span", {}, "–"),
      wanted: make("dd", {}, "–"),
      error: make("dd", {}, "–"),
      speed: make("dd", {}, "–"),
      share: make("dd", {}, "–"),
      shareBar: make("i"),
      queue: make("dd", {}, "–"),
      queueBar: make("i"),
      plot: make("div", { class: "plot" }),
    };
    const term = (text) => make("dt", {}, text);
    const bar = (inner) => make("div", { class: "bar", "aria-hidden": "true" }, inner);
    const numbers = make("dl", { class: "numbers" }, term("wanted"), row.wanted, term("error"), row.error, term("speed"), row.speed);
    numbers.append(term("of max"), row.share, bar(row.shareBar), term("queue"), row.queue, bar(row.queueBar));
    const position = make("p", { class: "position" }, row.position, " ", make("small", {}, motor.unit));
    row.element = make("div", { class: "motor" }, make("div", {}, make("h3", {}, motor.name), position, numbers), row.plot);
    return row;
  });
  $("motors").replaceChildren(...state.rows.map((row) => row.element));
  buildPlots();
  const machine = state.info.machines?.[0] ?? null;
  $("figure-card").hidden = !machine && state.info.motors.length < 2;
  state.figure = $("figure-card").hidden ? null : new Figure($("figure"), machine, state.info.motors);
  const names = state.info.motors.map((motor) => motor.name);
  $("figure-name").textContent = machine ? `Figure of ${machine.name}` : names.length > 1 ? `${names[1]} over ${names[0]}` : "Figure";
}

function buildPlots() {
  state.plots.forEach((plot) => plot.destroy());
  state.plots = (state.info?.motors ?? []).map((motor, place) => new MotorPlot(place, state.rows[place].plot, motor, state.quantity));
  document.querySelector(".legend").style.visibility = state.quantity === "position" ? "" : "hidden";
  state.mustDraw = true;
}

function draw(now) {
  requestAnimationFrame(draw);
  const every_ms = state.span_s > 100 ? 250 : 66;
  if (!state.mustDraw || document.hidden || now - state.drawnAt < every_ms || !state.info) return;
  state.drawnAt = now;
  state.mustDraw = false;
  $("time").textContent = history_.at.length ? clock(history_.latest) : "–";
  const { status } = state;
  if (history_.at.length) state.plots.forEach((plot) => plot.draw(history_, state.span_s));
  state.rows.forEach((row, place) => {
    const info = state.info.motors[place];
    const motor = status?.motors[place];
    if (!motor) return;
    const inUnit = (steps) => (info.start_steps + steps) / info.steps_per_unit;
    row.position.textContent = fixed(inUnit(motor.position), 1 / info.steps_per_unit);
    row.wanted.textContent = motor.target === null ? "–" : `${fixed(inUnit(motor.target), 1 / info.steps_per_unit)} ${info.unit}`;
    row.error.textContent = motor.target === null ? "–" : `${(motor.position - motor.target).toFixed(2).replace("-", "−")} steps`;
    row.speed.textContent = motor.speed === null ? "braking" : `${significant(motor.speed / info.steps_per_unit, 3)} ${info.unit}/s`;
    const share = motor.speed === null || !info.max_speed ? null : Math.abs(motor.speed) / info.max_speed;
    row.share.textContent = share === null ? "–" : `${significant(share * 100, 2)} %`;
    row.shareBar.style.transform = `scaleX(${Math.min(1, share ?? 0)})`;
    row.shareBar.parentElement.classList.toggle("high", share > 0.85);
    const [room, all] = motor.queue;
    row.queue.textContent = all ? `${all - room} of ${all}` : "–";
    row.queueBar.style.transform = `scaleX(${all ? (all - room) / all : 0})`;
  });
  const tip = state.figure?.draw(history_, Math.max(state.span_s, 20));
  $("tip").textContent = tip ? `${tip.map((value) => significant(value, 4)).join(", ")}${state.figure.isSquare ? ` ${state.figure.unit}` : ""}` : "";
  showVerdict();
  showPhase();
}

/** A position with the digits that one step is worth. */
function fixed(value, step) {
  const digits = Math.max(0, Math.min(6, Math.ceil(-Math.log10(step))));
  return value.toFixed(digits).replace("-", "−");
}

function showVerdict() {
  const { status, info } = state;
  const late = status?.lateness;
  const inTime = (ticks) => (info.tick_hz ? `${significant((ticks / info.tick_hz) * 1e6, 3)} µs` : `${ticks} ticks`);
  const facts = [
    ["Worst error seen", history_.at.length ? `${significant(state.worst_steps, 3)} steps` : "–"],
    ["Pulses late: median, worst", late ? `${inTime(late.p50_ticks)}, ${inTime(late.max_ticks)}` : "not measured"],
    ["Steps lost", late ? String(late.lost) : "not measured"],
    ["Lease: the board goes on alone for", status ? (status.lease_s === null ? "all of it" : `${significant(status.lease_s, 2)} s`) : "–"],
    ["Braked and joined again", String(state.rejoined)],
    ["Commands refused", String(state.refused)],
  ];
  $("facts").replaceChildren(...facts.flatMap(([name, value]) => [make("dt", {}, name), make("dd", {}, value)]));
  // Steps are whole, and a status is read within a step's time.
  const isGood = state.worst_steps <= 2 && !state.rejoined && !(late?.lost > 0) && !state.failed;
  $("verdict").textContent = !history_.at.length ? "–" : isGood ? "PASS so far" : state.failed ? "FAILED" : "look below";
  $("verdict").className = `chip ${!history_.at.length ? "" : isGood ? "good" : "bad"}`;
}

// ---------- knobs and cues

const knobs = new Map();

/** Sends a knob's value, 20 times a second at most; the last one always. */
function turn(knob, value) {
  knob.wanted = value;
  if (knob.timer) return;
  const flush = () => {
    if (knob.wanted === undefined) return (knob.timer = null);
    command("set", { knob: knob.info.name, value: knob.wanted });
    knob.wanted = undefined;
    knob.timer = setTimeout(flush, 50);
  };
  flush();
}

function buildKnobs() {
  const wanted = state.info.knobs ?? [];
  $("knobs-card").hidden = !wanted.length;
  const shape = JSON.stringify(wanted.map(({ value, ...rest }) => rest));
  if (shape !== state.knobShape) {
    state.knobShape = shape;
    knobs.clear();
    $("knobs").replaceChildren(...wanted.map(buildKnob));
  }
  for (const info of wanted) knobs.get(info.name).show(info.value);
}

function buildKnob(info, place) {
  const unit = info.unit ? ` ${info.unit}` : "";
  const id = `knob-${place}`;
  // The file may give no range: then it is one around the value, and other values can be typed.
  const least = info.least ?? Math.min(0, 2 * info.value);
  const greatest = info.greatest ?? Math.max(0, 2 * info.value, least + 1e-9);
  const range = make("input", { type: "range", id, class: "needs-control needs-live", min: least, max: greatest, step: (greatest - least) / 1000 || 1, disabled: "" });
  const field = make("input", { type: "text", inputmode: "decimal", class: "needs-control needs-live", "aria-label": `${info.name}, value`, autocomplete: "off", disabled: "" });
  const note = make("p", { class: "note" });
  const knob = {
    info,
    show(value) {
      if (!range.matches(":active")) range.value = value;
      if (document.activeElement !== field) field.value = `${significant(value)}${unit}`;
      range.setAttribute("aria-valuetext", `${significant(value)}${unit}`);
    },
    note(text) {
      note.textContent = text;
    },
  };
  range.addEventListener("input", () => {
    field.value = `${significant(Number(range.value))}${unit}`;
    turn(knob, Number(range.value));
  });
  // A number in the knob's unit, or text with a unit of its own.
  const type = () => {
    const text = field.value.trim().replace("−", "-");
    const bare = unit && text.endsWith(unit) ? text.slice(0, -unit.length) : text;
    if (text) turn(knob, Number.isFinite(Number(bare)) ? Number(bare) : text);
  };
  field.addEventListener("change", type);
  knobs.set(info.name, knob);
  const names = make("div", { class: "names" }, make("label", { for: id }, info.name), field);
  const ends = make("div", { class: "ends" }, make("span", {}, `${significant(least)}${unit}`), make("span", {}, `${significant(greatest)}${unit}`));
  return make("div", { class: "knob" }, names, range, ends, note);
}

function showKnob({ knob: name, value, ceiling }, isPast) {
  const knob = knobs.get(name);
  // The run's first line has the present values.
  if (!knob || isPast) return;
  knob.show(value);
  knob.note(ceiling ? `The nearest that the motors follow: ${ceiling}` : "");
}

function buildCues() {
  const names = state.info.cues ?? [];
  $("cues-card").hidden = !names.length;
  const buttons = names.map((name) => {
    const button = make("button", { type: "button", class: "needs-control" }, name);
    button.addEventListener("click", () => command("cue", { name }));
    return button;
  });
  $("cues").replaceChildren(...buttons);
  showCue();
}

function showCue() {
  for (const button of $("cues").children) button.setAttribute("aria-current", button.textContent === state.cue);
}

// ---------- the motion file

async function loadText() {
  try {
    const answer = await fetch("motion.toml");
    if (!answer.ok) return;
    state.fileText = await answer.text();
  } catch {
    // The line says so, too.
    return;
  }
  $("editor-card").hidden = !state.fileText && !state.info.is_live;
  if (state.isDirty) return;
  $("text").value = state.fileText;
  showLines();
}

function showLines(bad = null) {
  const count = $("text").value.split("\n").length;
  const lines = Array.from({ length: count }, (_, place) => (place + 1 === bad ? make("b", {}, String(bad)) : String(place + 1)));
  $("gutter").replaceChildren(...lines.flatMap((line) => [line, "\n"]));
  $("gutter").scrollTop = $("text").scrollTop;
  $("reload").disabled = !state.isDirty;
}

function textSays(text, kind) {
  $("text-says").textContent = text;
  $("text-says").className = kind;
}

function showError({ error, line, column }) {
  const place = line ? `Line ${line}${column ? `, column ${column}` : ""}: ` : "";
  textSays(`${place}${error}\nThe motion goes on as it was.`, "bad");
  // Another page's text has its error elsewhere.
  if (!line || state.sentText !== $("text").value) return;
  showLines(line);
  const text = $("text");
  const rows = text.value.split("\n");
  const start = rows.slice(0, line - 1).reduce((sum, row) => sum + row.length + 1, 0);
  const from = start + Math.min(Math.max((column ?? 1) - 1, 0), rows[line - 1]?.length ?? 0);
  text.focus({ preventScroll: true });
  text.setSelectionRange(from, start + (rows[line - 1]?.length ?? 0));
  const height = parseFloat(getComputedStyle(text).lineHeight);
  text.scrollTop = Math.max(0, (line - 4) * height);
  $("gutter").scrollTop = text.scrollTop;
}

// ---------- what people do

/** The first stop brakes within the limits; another one, not by a double tap, stops at once. */
function stop() {
  const now = performance.now();
  if (state.stopAskedAt !== null && now - state.stopAskedAt < 600) return;
  command(state.stopAskedAt === null ? "stop" : "stop_now");
  state.stopAskedAt ??= now;
  showPhase();
}

function goOn() {
  command(state.phase === "running" || state.phase === "resuming" ? "pause" : "resume");
}

let tempoTimer = null;
function setTempo(rate) {
  $("tempo-now").textContent = `${significant(rate, 3)}×`;
  clearTimeout(tempoTimer);
  tempoTimer = setTimeout(() => command("tempo", { rate }), 150);
}

$("stop").addEventListener("click", stop);
$("take").addEventListener("click", () => send({ control: !state.control.yours }));
$("go-on").addEventListener("click", goOn);
$("home").addEventListener("click", () => command("goto", { position: "0" }));
$("go").addEventListener("click", () => command("go"));
$("back").addEventListener("click", () => command("back"));
$("goto").addEventListener("submit", (event) => {
  event.preventDefault();
  if ($("position").value.trim()) command("goto", { position: $("position").value.trim() });
});
$("tempo").addEventListener("input", () => setTempo(Number((2 ** Number($("tempo").value)).toPrecision(3))));
for (const button of $("tempo-presets").children) button.addEventListener("click", () => setTempo(Number(button.dataset.rate)));
$("text").addEventListener("input", () => {
  state.isDirty = $("text").value !== state.fileText;
  showLines();
});
$("text").addEventListener("scroll", () => ($("gutter").scrollTop = $("text").scrollTop));
$("reload").addEventListener("click", () => {
  state.isDirty = false;
  textSays("", "");
  loadText();
});
$("take-over").addEventListener("click", () => {
  state.sentText = $("text").value;
  textSays("Sent …", "");
  command("motion", { text: state.sentText });
});

function choose(group, key, take) {
  for (const button of $(group).children) {
    button.addEventListener("click", () => {
      for (const other of $(group).children) other.setAttribute("aria-pressed", other === button);
      take(button.dataset[key]);
      state.mustDraw = true;
    });
  }
}
choose("quantity", "quantity", (quantity) => {
  state.quantity = quantity;
  buildPlots();
});
choose("span", "span", (span) => (state.span_s = Number(span)));

document.addEventListener(
  "keydown",
  (event) => {
    const { target } = event;
    const isText = target.matches("textarea, input[type=text]");
    if (event.code === "Space" && !(isText && !event.ctrlKey)) {
      // Before a button that has the focus takes it.
      event.preventDefault();
      event.stopPropagation();
      if (!event.repeat) stop();
      return;
    }
    if (isText && event.key === "Escape") return target.blur();
    if (isText || event.repeat || event.ctrlKey || event.altKey || event.metaKey || !state.control.yours) return;
    const keys = { p: goOn, g: () => command("go"), b: () => command("back") };
    keys[event.key.toLowerCase()]?.();
  },
  true,
);
// A button with the focus would take the space when it is let go.
document.addEventListener("keyup", (event) => {
  if (event.code === "Space" && !event.target.matches("textarea, input[type=text]")) event.preventDefault();
}, true);

matchMedia("(prefers-color-scheme: dark)").addEventListener("change", buildPlots);
new ResizeObserver(() => (state.mustDraw = true)).observe(document.body);

connect();
requestAnimationFrame(draw);
