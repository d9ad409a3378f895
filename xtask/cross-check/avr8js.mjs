// Runs timer programs in avr8js and prints what it did, in the lines that the emulator's example `cross_check` prints too.
//
//     node avr8js.mjs MODULE < cases        (MODULE: the path of the package's index.js)
//
// A case: the number of the timer, then the program's words, hexadecimal. It runs until SLEEP. The answer: what it
// pushed, and the edges of the pins as CYCLE:PIN=LEVEL; with `stop=CYCLE:REASON` when from there on avr8js is known not
// to be the chip (below).
//
// avr8js is right in what a timer counts, when it matches, what it does to its pins, and when it takes a buffered value.
// Where it departs from the chip, and what is done about it here. Sections are those of the ATmega328P's datasheet,
// DS40002061B; each line is about one thing, and all else is compared as avr8js has it.
//
// MATCH    It acts on a match when the counter reaches the value; the chip when it leaves it, one timer clock later
//          (figures 15-8 to 15-11, 16-10 to 16-13, 18-8 to 18-11). Put off here by one timer clock: pin and flag. A
//          write to the counter before that drops it (15.5.3).
// BOTTOM   The same for TOV in the phase correct modes: set when the counter leaves BOTTOM (figure 16-12, text).
// ABOVE    A compare value above TOP matches at the overflow; the chip's never does (15.5: the comparator wants
//          equality). Here as the chip's.
// SYMMETRY In the phase correct modes the pin is at TOP as a match on the way up leaves it, also without one (15.7.4,
//          last paragraphs). Added.
// FORCE    A forced compare takes the pin from the port although COMnx1:0 is 0; the chip's does not (15.6). Here ignored.
// STORE    STS writes in the first of its two cycles; the chip's bus in the second (figure 7-6). Done here as the chip.
// SELECT   Writing TCCRnB begins the prescaler anew; the chip's runs free (17.1). Here: unless the clock stays selected.
// UPDATE   In the phase correct modes it takes buffered values when the counter reaches TOP or BOTTOM; the chip when it
//          leaves them (figure 16-12). Values written in between are added.
// LATCH    A buffered compare value whose write takes effect at the very clock of the update is taken with it; in the
//          chip both registers have the same clock, and the update gets what was there. Here as the chip.
// WINDOW   With a prescaler, the chip's comparator looks when the timer clock comes (figure 15-9): a compare value that
//          is written in the clock in which the counter equals the old or the new one is judged by what it is then.
//          avr8js judged the old one before; so it does TOP, at clk/1 too. Comparing stops there.
// TOP      A TOP at or below the counter lets the chip run on to MAX (15.7.2, 16.9.2); avr8js takes the remainder.
//          Comparing stops there.
// DOWN     After TOP was lowered in a phase correct mode, the counter meets the new one on its way down. Whether that is
//          TOP once more, for buffered values, the datasheet leaves open (16.9.4). Comparing stops there.
// TIFR     Writing it clears all that is not written, and never ICF, which it does not set: programs write TOV, OCFA and
//          OCFB at once, and look at these alone.
import { readFileSync } from 'node:fs';
import { createRequire } from 'node:module';

const avr8js = createRequire(import.meta.url)(process.argv[2]);
const { AVRIOPort, AVRTimer, CPU, avrInstruction, portBConfig, portDConfig } = avr8js;
const timerConfigs = [avr8js.timer0Config, avr8js.timer1Config, avr8js.timer2Config];

const FLASH_WORDS = 0x4000;
const SRAM_BYTES = 0x800;
const PHASE_CORRECT = [1, 4];
const OCRA_IS_TOP = 1;
const ICR_IS_TOP = 2;
const IMMEDIATE = 0;
const AT_TOP = 1;
const CLEAR = 2; // COMnx1:0, of a match on the way up; 3 sets
const PIN_OVERRIDE = { SET: 2, CLEAR: 3 }; // avr8js's PinOverrideMode, which it does not export
const SLEEP = 0x9588;
const MOST_CYCLES = 2_000_000;

const isStore = (word) => (word & 0xfe0f) === 0x9200;
const isLoadOrPush = (word) => (word & 0xfe0f) === 0x9000 || (word & 0xfe0f) === 0x920f;

/** Runs one case; gives back its answer. */
function run(number, words) {
  const program = new Uint16Array(FLASH_WORDS);
  program.set(words);
  const cpu = new CPU(program, SRAM_BYTES);
  const ports = [['B', new AVRIOPort(cpu, portBConfig)], ['D', new AVRIOPort(cpu, portDConfig)]];
  const config = timerConfigs[number];
  const timer = new AVRTimer(cpu, config);

  const edges = [];
  let stop = '';
  // The cycle at whose end the pin changes: what an instruction writes is there when it ends.
  let stamp = null;
  for (const [name, port] of ports) {
    port.addListener((now, before) => {
      const ddr = cpu.data[port.portConfig.DDR];
      for (let bit = 0; bit < 8; bit++) {
        if ((now ^ before) & ddr & (1 << bit)) {
          edges.push(`${stamp ?? cpu.cycles + 1}:${name}${bit}=${(now >> bit) & 1}`);
        }
      }
    });
  }

  // MATCH and BOTTOM: what is put off by a timer clock.
  const later = [];
  // The timer clock after the one at which the counter has just counted.
  const nextClock = () => {
    const stops = timer.updateDivider && !config.dividers[timer.CS];
    return stops ? Infinity : timer.lastCycle + timer.divider;
  };
  // What a pin does (COMnx1:0) is what is set when the timer clock comes: a write that takes effect then is too late.
  const pinModes = { since: 0, A: 0, B: 0 };
  const pinMode = (pin, cycle) => (cycle === pinModes.since ? pinModes[pin] : timer[`comp${pin}`]);
  const doWhatIsDue = () => {
    while (later.length && later[0].cycle <= cpu.cycles) {
      const { cycle, action } = later.shift();
      stamp = cycle;
      action(cycle);
      stamp = null;
    }
  };
  let forcing = false;
  const { checkForceCompare, updateCompPin } = timer;
  timer.checkForceCompare = (value) => {
    forcing = true;
    checkForceCompare.call(timer, value);
    forcing = false;
  };
  timer.updateCompPin = (action, pin, bottom = false) => {
    if (forcing) {
      // FORCE.
      if (action) updateCompPin.call(timer, action, pin, bottom);
      return;
    }
    // The direction of counting is that at the match.
    const { countingUp } = timer;
    const act = (cycle) => {
      const now = timer.countingUp;
      timer.countingUp = countingUp;
      updateCompPin.call(timer, pinMode(pin, cycle), pin, bottom);
      timer.countingUp = now;
    };
    // A match at TOP acts at the very clock of BOTTOM: it comes first.
    later.push({ cycle: bottom ? timer.lastCycle : nextClock(), action: act, isMatch: !bottom });
  };
  const setInterruptFlag = cpu.setInterruptFlag.bind(cpu);
  cpu.setInterruptFlag = (interrupt) => {
    if (interrupt === timer.OVF && PHASE_CORRECT.includes(timer.timerMode)) {
      later.push({ cycle: nextClock(), action: () => setInterruptFlag(interrupt) });
    } else if (interrupt !== timer.OVF) {
      later.push({ cycle: nextClock(), action: () => setInterruptFlag(interrupt), isMatch: true });
    } else {
      setInterruptFlag(interrupt);
    }
  };

  const writeCounter = cpu.writeHooks[config.TCNT];
  cpu.writeHooks[config.TCNT] = (...write) => {
    // What is due when the write takes effect has happened.
    const rest = later.filter(({ cycle, isMatch }) => !isMatch || cycle <= cpu.cycles + 1);
    later.splice(0, later.length, ...rest);
    return writeCounter(...write);
  };

  // ABOVE.
  const { timerUpdated } = timer;
  timer.timerUpdated = (value, before) => {
    const { ocrA, ocrB } = timer;
    if (value < before) {
      if (ocrA > before) timer.ocrA = NaN;
      if (ocrB > before) timer.ocrB = NaN;
    }
    timerUpdated.call(timer, value, before);
    Object.assign(timer, { ocrA, ocrB });
  };

  // SYMMETRY.
  let turnedAt = -1;
  const { phasePwmCount } = timer;
  timer.phasePwmCount = (...count) => {
    const wasUp = timer.countingUp;
    const value = phasePwmCount.apply(timer, count);
    if (wasUp && !timer.countingUp) {
      turnedAt = value;
      for (const [pin, compare] of [['A', () => timer.ocrA], ['B', () => timer.ocrB]]) {
        const isTop = pin === 'A' && timer.topValue === OCRA_IS_TOP;
        const act = (cycle) => {
          const mode = pinMode(pin, cycle);
          if (mode < CLEAR || compare() >= value || isTop) return;
          timer[`updateComp${pin}`](mode === CLEAR ? PIN_OVERRIDE.CLEAR : PIN_OVERRIDE.SET);
        };
        later.push({ cycle: nextClock(), action: act, isMatch: true });
      }
    }
    if (!wasUp && value && value === timer.TOP) endHere('DOWN');
    return value;
  };

  const writeControlA = cpu.writeHooks[config.TCCRA];
  cpu.writeHooks[config.TCCRA] = (...write) => {
    Object.assign(pinModes, { since: cpu.cycles + 1, A: timer.compA, B: timer.compB });
    return writeControlA(...write);
  };

  // SELECT.
  const writeControlB = cpu.writeHooks[config.TCCRB];
  cpu.writeHooks[config.TCCRB] = (value, ...rest) => {
    const same = (value & 7) === timer.CS && timer.divider && !timer.updateDivider;
    const done = writeControlB(value, ...rest);
    // What a stopped clock has put off waits for it.
    for (const entry of later) {
      if (!(value & 7) && entry.cycle > cpu.cycles + 1) entry.cycle = Infinity;
      if (value & 7 && entry.cycle === Infinity) entry.cycle = cpu.cycles + 1 + config.dividers[value & 7];
    }
    if (same) {
      timer.updateDivider = false;
      cpu.clearClockEvent(timer.count);
      cpu.addClockEvent(timer.count, timer.lastCycle + timer.divider - cpu.cycles);
    }
    return done;
  };

  // WINDOW, TOP, DOWN and LATCH.
  const endHere = (reason) => {
    stop ||= `${cpu.cycles}:${reason}`;
  };
  for (const [register, current] of [['OCRA', () => timer.ocrA], ['OCRB', () => timer.ocrB], ['ICR', () => timer.icr]]) {
    const address = config[register];
    const write = cpu.writeHooks[address];
    if (!address) continue;
    cpu.writeHooks[address] = (...given) => {
      if (timer.divider && register !== 'ICR' && timer.ocrUpdateMode !== IMMEDIATE) {
        const act = () => {
          write(...given);
          // UPDATE.
          const isAtTop = timer.ocrUpdateMode === AT_TOP && timer.tcnt === turnedAt && !timer.countingUp;
          const isAtBottom = timer.ocrUpdateMode !== AT_TOP && timer.tcnt === 0 && timer.countingUp;
          if (PHASE_CORRECT.includes(timer.timerMode) && (isAtTop || isAtBottom)) {
            timer[register === 'OCRA' ? 'ocrA' : 'ocrB'] = given[0] | (timer.config.bits === 16 ? timer.highByteTemp << 8 : 0);
          }
        };
        later.push({ cycle: cpu.cycles + 1, action: act });
        return false;
      }
      const before = current();
      const done = write(...given);
      const after = current();
      const isTop = timer.topValue === { OCRA: OCRA_IS_TOP, ICR: ICR_IS_TOP }[register];
      if (timer.divider && before !== after) {
        if (isTop && timer.tcnt + 1 >= after) endHere('TOP');
        const window = timer.divider > 1 && (timer.tcnt === before || timer.tcnt === after);
        if (window || (isTop && (timer.tcnt === before || timer.tcnt + 1 === before))) endHere('WINDOW');
      }
      return done;
    };
  }

  const tick = () => {
    cpu.tick();
    later.sort((a, b) => a.cycle - b.cycle);
    doWhatIsDue();
  };
  while (program[cpu.pc] !== SLEEP && cpu.cycles < MOST_CYCLES && !stop) {
    const word = program[cpu.pc];
    if (isStore(word)) {
      // STORE.
      cpu.cycles++;
      tick();
      avrInstruction(cpu);
      cpu.cycles--;
    } else {
      if (isLoadOrPush(word)) {
        // Only so that no timer clock falls between two looks: it reads in its second cycle by itself.
        cpu.cycles++;
        tick();
        cpu.cycles--;
      }
      avrInstruction(cpu);
    }
    tick();
  }
  const end = program[cpu.pc] === SLEEP || stop ? cpu.cycles : 'never';
  const pushed = Buffer.from(cpu.data.slice(cpu.SP + 1)).reverse().toString('hex');
  return `end=${end} pushed=${pushed} edges=${edges.join(',')}${stop && ` stop=${stop}`}`;
}

for (const line of readFileSync(0, 'utf8').split('\n')) {
  if (!line) continue;
  const [number, ...words] = line.split(' ').map((word) => parseInt(word, 16));
  console.log(run(number, words));
}
