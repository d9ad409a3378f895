"use strict";
// The plots of the page: curves of motors over time, and the machine's figure.

/** Statuses that are kept: those of the last ten minutes of the motion, as the server keeps them. */
class History {
  constructor() {
    this.kept_s = 600;
    this.clear(0);
  }

  clear(motors) {
    this.at = [];
    this.motors = Array.from({ length: motors }, () => ({ made: [], wanted: [], speed: [] }));
  }

  get latest() {
    return this.at.length ? this.at[this.at.length - 1] : 0;
  }

  add(at_s, motors) {
    if (motors.length !== this.motors.length) this.clear(motors.length);
    this.at.push(at_s);
    motors.forEach((motor, place) => {
      const kept = this.motors[place];
      kept.made.push(motor.position);
      kept.wanted.push(motor.target);
      kept.speed.push(motor.speed);
    });
    // In one go now and then: to remove one element from the front of a long list takes long.
    if (this.at.length % 1000 === 0) this.forget(at_s - this.kept_s);
  }

  forget(before_s) {
    const count = this.since(before_s);
    if (count < 500) return;
    this.at.splice(0, count);
    for (const motor of this.motors) for (const column of Object.values(motor)) column.splice(0, count);
  }

  /** The place of the first status at that time or later. */
  since(at_s) {
    let [low, high] = [0, this.at.length];
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.at[middle] < at_s) low = middle + 1;
      else high = middle;
    }
    return low;
  }
}

const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

/** A number with so many significant digits, without a tail of zeros. */
function significant(value, digits = 4) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  if (value === 0 || Math.abs(value) < 1e-9) return "0";
  const places = Math.max(0, Math.min(9, digits - 1 - Math.floor(Math.log10(Math.abs(value)))));
  return String(Number(value.toFixed(places))).replace("-", "−");
}

function clock(at_s) {
  if (!Number.isFinite(at_s)) return "–";
  const total = Math.max(0, Math.floor(at_s));
  const two = (value) => String(value).padStart(2, "0");
  const [hours, minutes, seconds] = [Math.floor(total / 3600), Math.floor(total / 60) % 60, total % 60];
  return hours ? `${hours}:${two(minutes)}:${two(seconds)}` : `${minutes}:${two(seconds)}`;
}

/** What a plot can show of a motor: unit and curves. */
const QUANTITIES = {
  position: {
    unit: (info) => info.unit,
    curves: (info, kept, from) => {
      const inUnit = (steps) => (steps === null ? null : (info.start_steps + steps) / info.steps_per_unit);
      // A target counts from the law's own zero, as a position does from the start.
      return [kept.wanted.slice(from).map(inUnit), kept.made.slice(from).map(inUnit)];
    },
  },
  speed: {
    unit: (info) => `${info.unit}/s`,
    curves: (info, kept, from) => [kept.speed.slice(from).map((speed) => (speed === null ? null : speed / info.steps_per_unit))],
  },
  share: {
    unit: () => "% of max",
    curves: (info, kept, from) => {
      const share = (speed) => (speed === null || !info.max_speed ? null : (100 * Math.abs(speed)) / info.max_speed);
      return [kept.speed.slice(from).map(share)];
    },
  },
  error: {
    unit: () => "steps",
    curves: (info, kept, from) => {
      const made = kept.made.slice(from);
      return [made.map((made, place) => (kept.wanted[from + place] === null ? null : made - kept.wanted[from + place]))];
    },
  },
};

/** A curve of one motor over time. */
class MotorPlot {
  constructor(place, element, info, quantity) {
    this.place = place;
    this.element = element;
    this.info = info;
    this.quantity = QUANTITIES[quantity];
    element.setAttribute("role", "img");
    element.setAttribute("aria-label", `${quantity} of ${info.name} over time`);
    const two = quantity === "position";
    const axis = { stroke: colour("soft"), grid: { stroke: colour("line"), width: 1 }, ticks: { stroke: colour("line"), width: 1, size: 4 }, font: "11px system-ui" };
    const line = (name, width) => ({ stroke: colour(name), width, alpha: width > 3 ? 0.55 : 1, points: { show: false }, spanGaps: false });
    const curves = two ? [line("wanted", 6), line("made", 1.8)] : [line("made", 1.8)];
    const unit = { position: info.unit, speed: `${info.unit}/s`, share: "%", error: "steps" }[quantity];
    // The unit is at the highest number.
    const numbers = (ticks) => ticks.map((tick, place) => significant(tick, 5) + (place === ticks.length - 1 ? ` ${unit}` : ""));
    const limits = quantity === "share" ? (_, low, high) => [0, Math.max(5, Math.min(110, (high || 0) * 1.1))] : (_, low, high) => MotorPlot.around(low, high);
    this.plot = new uPlot(
      {
        ...this.size(),
        legend: { show: false },
        cursor: { show: false },
        padding: [6, 18, 0, 0],
        scales: { x: { time: false }, y: { range: limits } },
        axes: [
          { ...axis, size: 24, gap: 2, values: (_, ticks) => ticks.map(clock), space: 60, incrs: [1, 2, 5, 10, 20, 30, 60, 120, 300] },
          { ...axis, size: 58, gap: 3, space: 28, values: (_, ticks) => numbers(ticks) },
        ],
        series: [{}, ...curves],
      },
      [[], ...curves.map(() => [])],
      element,
    );
  }

  static around(low, high) {
    if (low === null || high === null) return [-1, 1];
    const room = Math.max((high - low) * 0.08, Math.abs(high) * 1e-6, 1e-6);
    return [low - room, high + room];
  }

  size() {
    return { width: Math.max(120, this.element.clientWidth), height: this.element.clientHeight || 160 };
  }

  draw(history, span_s) {
    const { width, height } = this.size();
    if (width !== this.plot.width || height !== this.plot.height) this.plot.setSize({ width, height });
    const from = history.since(history.latest - span_s);
    this.plot.batch(() => {
      this.plot.setData([history.at.slice(from), ...this.quantity.curves(this.info, history.motors[this.place], from)], false);
      // At first the curve grows from the left.
      const max = Math.max(history.latest, (history.at[0] ?? 0) + span_s);
      this.plot.setScale("x", { min: max - span_s, max });
    });
  }

  destroy() {
    this.plot.destroy();
  }
}

/** The effector of a delta robot for these angles (rad): where three spheres meet, as crates/motion/src/machine.rs has it. */
function deltaPoint({ base_mm, upper_arm_mm, forearm_mm, effector_mm }, angles) {
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const minus = (a, b) => a.map((value, k) => value - b[k]);
  const times = (a, factor) => a.map((value) => value * factor);
  const [a, b, c] = angles.map((angle, arm) => {
    const out = base_mm - effector_mm + upper_arm_mm * Math.cos(angle);
    const turn = (arm * 2 * Math.PI) / 3;
    return [Math.cos(turn) * out, Math.sin(turn) * out, -upper_arm_mm * Math.sin(angle)];
  });
  const [ab, ac] = [minus(b, a), minus(c, a)];
  const across = Math.sqrt(dot(ab, ab));
  const e1 = times(ab, 1 / across);
  const along = dot(e1, ac);
  const rest = minus(ac, times(e1, along));
  const up = Math.sqrt(dot(rest, rest));
  const e2 = times(rest, 1 / up);
  const e3 = [e1[1] * e2[2] - e1[2] * e2[1], e1[2] * e2[0] - e1[0] * e2[2], e1[0] * e2[1] - e1[1] * e2[0]];
  const u = across / 2;
  const v = (along * along + up * up - 2 * along * u) / (2 * up);
  const square = forearm_mm * forearm_mm - u * u - v * v;
  if (!(square >= 0)) return null;
  const down = e3[2] < 0 ? Math.sqrt(square) : -Math.sqrt(square);
  return [0, 1, 2].map((k) => a[k] + u * e1[k] + v * e2[k] + down * e3[k]);
}

/** The figure that a machine draws, seen from above; without a machine, motor 1 against motor 2. */
class Figure {
  constructor(canvas, machine, motors) {
    this.canvas = canvas;
    this.machine = machine;
    this.motors = motors;
    this.places = machine ? machine.motors : [0, 1];
    this.unit = machine ? machine.unit : motors[0].unit;
    // Different units have no common scale.
    this.isSquare = Boolean(machine) || motors[0].unit === motors[1].unit;
  }

  /** Where the tip is when the motors have made these steps. */
  tip(steps) {
    if (steps.some((value) => value === null || value === undefined)) return null;
    if (!this.machine) return steps.map((value, k) => (this.motors[k].start_steps + value) / this.motors[k].steps_per_unit);
    const { home, kinematics } = this.machine;
    const scale = kinematics.kind === "delta" ? kinematics.steps_per_rad : kinematics.steps_per_unit;
    const at = steps.map((value, k) => (home[k] + value) / scale[k]);
    return kinematics.kind === "delta" ? deltaPoint(kinematics, at) : at;
  }

  path(history, from, column) {
    const columns = this.places.map((place) => history.motors[place][column]);
    const path = [];
    // Longer histories have more points than there are places on the screen.
    const stride = Math.max(1, Math.ceil((history.at.length - from) / 4000));
    for (let place = from; place < history.at.length; place += stride) path.push(this.tip(columns.map((values) => values[place])));
    const last = history.at.length - 1;
    if (stride > 1) path.push(this.tip(columns.map((values) => values[last])));
    return path;
  }

  draw(history, span_s) {
    const ratio = window.devicePixelRatio || 1;
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight];
    if (!width || !history.at.length) return null;
    if (this.canvas.width !== Math.round(width * ratio)) {
      this.canvas.width = Math.round(width * ratio);
      this.canvas.height = Math.round(height * ratio);
    }
    const from = history.since(history.latest - span_s);
    const paths = { wanted: this.path(history, from, "wanted"), made: this.path(history, from, "made") };
    const known = [...paths.wanted, ...paths.made].filter(Boolean);
    if (!known.length) return null;
    const range = [0, 1].map((k) => {
      let [low, high] = [Infinity, -Infinity];
      for (const point of known) [low, high] = [Math.min(low, point[k]), Math.max(high, point[k])];
      return { middle: (low + high) / 2, size: Math.max(high - low, 1e-6) };
    });
    const edge = 26;
    let scale = [(width - 2 * edge) / range[0].size, (height - 2 * edge) / range[1].size];
    if (this.isSquare) scale = [Math.min(...scale), Math.min(...scale)];
    const place = ([x, y]) => [width / 2 + (x - range[0].middle) * scale[0], height / 2 - (y - range[1].middle) * scale[1]];
    const context = this.canvas.getContext("2d");
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    context.lineJoin = "round";
    for (const [name, thick] of [["wanted", 6], ["made", 1.8]]) {
      context.beginPath();
      let isDown = false;
      for (const point of paths[name]) {
        if (point) context[isDown ? "lineTo" : "moveTo"](...place(point));
        isDown = Boolean(point);
      }
      context.strokeStyle = colour(name);
      context.lineWidth = thick;
      context.globalAlpha = thick > 3 ? 0.55 : 1;
      context.stroke();
    }
    const tip = paths.made[paths.made.length - 1];
    if (tip) {
      context.beginPath();
      context.arc(...place(tip), 6, 0, 2 * Math.PI);
      context.fillStyle = colour("text");
      context.fill();
    }
    this.drawScale(context, width, height, scale[0]);
    return tip;
  }

  /** A bar of a round length along x. */
  drawScale(context, width, height, scale) {
    const most = (width * 0.3) / scale;
    const power = 10 ** Math.floor(Math.log10(most));
    const length = [5, 2, 1].map((factor) => factor * power).find((length) => length <= most);
    const [x, y] = [10, height - 8];
    context.strokeStyle = context.fillStyle = colour("soft");
    context.lineWidth = 1.5;
    context.beginPath();
    context.moveTo(x, y - 4);
    context.lineTo(x, y);
    context.lineTo(x + length * scale, y);
    context.lineTo(x + length * scale, y - 4);
    context.stroke();
    context.font = "12px system-ui";
    context.fillText(`${significant(length)} ${this.unit}`, x, y - 8);
  }
}
