// Runs timer programs in avr8js and prints what it did, in the lines that the emulator's example `cross_check` prints too.
//
//     node avr8js.mjs FOLDER-OF-THE-PACKAGE < cases
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
//          (figures 15-8 to 15-11, 16-10 to 16-13, 18-8 to 18-11). Put off here by one timer clock: pin and flag.
// BOTTOM   The same for TOV in the phase correct modes: set when the counter leaves BOTTOM (figure 16-12, text).
// STORE    STS writes in the first of its two cycles; the chip's bus in the second (figure 7-6). Done here as the chip.
// SELECT   Writing TCCRnB begins the prescaler anew; the chip's runs free (17.1). Here: unless the clock stays selected.
// WINDOW   With a prescaler, the chip's comparator looks when the timer clock comes (figure 15-9): a compare value that
//          is written in the clock in which the counter equals the old or the new one is judged by what it is then.
//          avr8js judged the old one before. Comparing stops there.
// TOP      A TOP at or below the counter lets the chip run on to MAX (15.7.2, 16.9.2); avr8js takes the remainder.
//          Comparing stops there.
import { readFileSync } from 'node:fs';
import { createRequire } from 'node:module';

const avr8js = createRequire(import.meta.url)(process.argv[2]);
const { AVRIOPort, AVRTimer, CPU, avrInstruction, portBConfig, portDConfig } = avr8js;
const timerConfigs = [avr8js.timer0Config, avr8js.timer1Config, avr8js.timer2Config];

const FLASH_WORDS = 0x4000;
const SRAM_BYTES = 0x800;
const NORMAL = 0;
const PHASE_CORRECT = [1, 4];
const CTC = 2;
const SLEEP = 0x9588;
const MOST_CYCLES = 400_000;

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
  const putOff = (action) => later.push({ cycle: timer.lastCycle + timer.divider, action });
  const doWhatIsDue = () => {
    while (later.length && later[0].cycle <= cpu.cycles) {
      const { cycle, action } = later.shift();
      stamp = cycle;
      action();
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
      updateCompPin.call(timer, action, pin, bottom);
    } else if (bottom) {
      // A match at TOP acts at this very clock: it comes first.
      later.push({ cycle: timer.lastCycle, action: () => updateCompPin.call(timer, action, pin, true) });
    } else {
      // The direction of counting is that at the match.
      const name = `updateComp${pin}`;
      const plain = timer[name];
      timer[name] = (mode) => putOff(() => plain.call(timer, mode));
      updateCompPin.call(timer, action, pin, false);
      timer[name] = plain;
    }
  };
  const setInterruptFlag = cpu.setInterruptFlag.bind(cpu);
  cpu.setInterruptFlag = (interrupt) => {
    if (interrupt !== timer.OVF || PHASE_CORRECT.includes(timer.timerMode)) {
      putOff(() => setInterruptFlag(interrupt));
    } else {
      setInterruptFlag(interrupt);
    }
  };

  // SELECT.
  const writeControlB = cpu.writeHooks[config.TCCRB];
  cpu.writeHooks[config.TCCRB] = (value, ...rest) => {
    const same = (value & 7) === timer.CS && timer.divider && !timer.updateDivider;
    const done = writeControlB(value, ...rest);
    if (same) {
      timer.updateDivider = false;
      cpu.clearClockEvent(timer.count);
      cpu.addClockEvent(timer.count, timer.lastCycle + timer.divider - cpu.cycles);
    }
    return done;
  };

  // WINDOW and TOP.
  const endHere = (reason) => {
    stop ||= `${cpu.cycles}:${reason}`;
  };
  for (const [register, current] of [['OCRA', () => timer.ocrA], ['OCRB', () => timer.ocrB], ['ICR', () => timer.icr]]) {
    const address = config[register];
    const write = cpu.writeHooks[address];
    if (!address) continue;
    cpu.writeHooks[address] = (value, ...rest) => {
      const before = current();
      const done = write(value, ...rest);
      const after = current();
      if (timer.divider && before !== after) {
        const isTop = register === 'ICR' || (timer.timerMode === CTC && timer.topValue === 1 && register === 'OCRA');
        if (isTop && timer.timerMode !== NORMAL && timer.tcnt >= timer.TOP) endHere('TOP');
        if (timer.divider > 1 && (timer.tcnt === before || timer.tcnt === after)) endHere('WINDOW');
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
