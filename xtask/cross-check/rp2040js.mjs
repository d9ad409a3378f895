// Runs ARMv6-M code in rp2040js and prints what it did, in the lines that the emulator's example `cross_check_arm` prints
// too (it says what they are).
//
//     node rp2040js.mjs MODULE instructions < cases        (MODULE: the path of the package's index.js)
//     node rp2040js.mjs MODULE program IMAGE
//     node rp2040js.mjs MODULE firmware IMAGE < what `cross_check_arm firmware` has printed
//     node rp2040js.mjs MODULE usb IMAGE
//
// `firmware` executes the same instructions: what they load comes from the other side, so that peripherals and time do not
// matter; exceptions are entered where it entered them. It prints `COUNT instructions, LOADS loads, EXCEPTIONS exceptions,
// CHAINED of them chained`, or where the two part.
// `usb` lets rp2040js's own PC enumerate the device.
//
// The last line is `met NAME=TIMES...`: how often it was put right where rp2040js 1.4.1 is not the manual's (ARM DDI 0419E)
// or the TRM's (DDI 0484C):
//
// SHIFT    A shift by a register that holds 0 sets C, which it leaves alone (A6.7.39, A6.7.12, A6.7.54); LSL by more than
//          32 takes C from the wrong bit (A6.7.36: it is 0).
// CARRY    ADC and SBC add the carry to an operand before V is worked out, which is then wrong where that sum overflows
//          (A2.2.1, AddWithCarry).
// STORE    STM does not write the base register back if it is in the list (A6.7.58: it always does).
// BANK     MSR leaves bits 1 and 0 of the stack pointer that is not in use as they are written (B1.4.2: they are 0).
// LINK     BLX LR goes to the new value of LR (A6.7.15: the target is read first).
// STACK    PUSH with LR and POP with the program counter take a cycle less than 1 + N and 3 + N (table 3-1).
import { readFileSync } from 'node:fs';
import { pathToFileURL } from 'node:url';

const { RP2040, USBCDC } = await import(pathToFileURL(process.argv[2]));

const RAM = 0x20000000;
const CODE = RAM + 0x8000;
const WFI = 0xbf30;
const LINE = 1000;
const MOST_INSTRUCTIONS = 20_000_000;
const FLASH = 0x10000000;
const ELF_MAGIC = 0x464c457f;
const USB_BYTES = 1000;
const usbByte = (at) => (at * 7 + (at >> 8)) & 0xff;

const mcu = new RP2040();
const quiet = () => {};
mcu.logger = { debug: quiet, info: quiet, warn: quiet, error: quiet };
const { core } = mcu;
const hex = (value, digits = 0) => (value >>> 0).toString(16).padStart(digits, '0');
const flags = () => (core.N ? 8 : 0) | (core.Z ? 4 : 0) | (core.C ? 2 : 0) | (core.V ? 1 : 0);

const met = { SHIFT: 0, CARRY: 0, STORE: 0, BANK: 0, LINK: 0, STACK: 0 };

/** Executes an instruction, and puts right what is listed above. */
function step() {
  const word = mcu.readUint16(core.PC);
  const { C } = core;
  const places = core.registers[(word >> 3) & 7] & 0xff;
  const operand = core.registers[(word >> 3) & 7];
  const first = core.registers[word & 7];
  const link = core.LR;
  core.executeInstruction();
  const change = (name, field, value) => {
    if (core[field] !== value) met[name]++;
    core[field] = value;
  };
  switch (word >> 6) {
    case 0x102: // LSL
      if (places > 32) change('SHIFT', 'C', false);
      break;
    case 0x103: // LSR
    case 0x104: // ASR
    case 0x107: // ROR
      if (places === 0) change('SHIFT', 'C', C);
      break;
    case 0x105: // ADC
    case 0x106: { // SBC
      const added = word >> 6 === 0x105 ? operand : ~operand;
      const sum = core.registers[word & 7];
      change('CARRY', 'V', ((first ^ sum) & (added ^ sum)) < 0);
      break;
    }
  }
  if (word >> 3 === 0x47f0 >> 3) {
    core.PC = (link & ~1) >>> 0;
    met.LINK++;
  }
  if (core.bankedSP & 3) {
    core.bankedSP = (core.bankedSP & ~3) >>> 0;
    met.BANK++;
  }
  if (word >> 11 === 0b11000 && (word >> ((word >> 8) & 7)) & 1) {
    let count = 0;
    for (let bit = 0; bit < 8; bit++) count += (word >> bit) & 1;
    core.registers[(word >> 8) & 7] += 4 * count;
    met.STORE++;
  }
  if (word >> 8 === 0xb5 || word >> 8 === 0xbd) {
    core.cycles++;
    met.STACK++;
  }
}

const report = () => `met ${Object.entries(met).map(([name, times]) => `${name}=${times}`).join(' ')}`;

/** The memory that every case starts from. */
const pattern = (address) => Math.imul(address, 0x9e3779b1) >>> 24;

function instructions() {
  for (let at = 0; at < mcu.sram.length; at++) mcu.sram[at] = pattern(RAM + at);
  const fresh = mcu.sram.slice();
  let written = [];
  for (const bytes of [1, 2, 4]) {
    const name = `writeUint${8 * bytes}`;
    const write = mcu[name].bind(mcu);
    mcu[name] = (address, value) => {
      written.push([address >>> 0, bytes, bytes === 4 ? value >>> 0 : value & (2 ** (8 * bytes) - 1)]);
      write(address >>> 0, value);
    };
  }
  const answers = [];
  for (const line of readFileSync(0, 'utf8').split('\n')) {
    if (!line) continue;
    const [first, second, startFlags, digits] = line.split(' ');
    mcu.sramView.setUint16(CODE - RAM, parseInt(first, 16), true);
    mcu.sramView.setUint16(CODE - RAM + 2, parseInt(second, 16), true);
    core.APSR = (parseInt(startFlags, 16) << 28) >>> 0;
    core.PM = false;
    core.nPRIV = false;
    core.switchStack(0);
    core.bankedSP = 0;
    core.IPSR = 0;
    core.pendingSVCall = false;
    core.interruptsUpdated = false;
    core.waiting = false;
    core.cycles = 0;
    for (let number = 0; number < 15; number++) {
      core.registers[number] = parseInt(digits.slice(8 * number, 8 * number + 8), 16);
    }
    core.PC = CODE;
    step();
    const registers = [...core.registers.slice(0, 15)].map((value) => hex(value, 8)).join('');
    const control = core.SPprocess === core.SP && core.SPprocess !== core.SPmain ? 2 : 0;
    const special = `${core.PM ? 1 : 0} ${hex(core.SPmain, 8)} ${hex(core.SPprocess, 8)} ${control}`;
    const writes = written.map(([address, bytes, value]) => ` ${hex(address, 8)}:${bytes}=${hex(value)}`).join('');
    answers.push(`${hex(core.PC, 8)} ${hex(flags())} ${core.cycles} ${registers} ${special}${writes}`);
    for (const [address, bytes] of written) {
      mcu.sram.set(fresh.subarray(address - RAM, address - RAM + bytes), address - RAM);
    }
    mcu.sram.set(fresh.subarray(CODE - RAM, CODE - RAM + 4), CODE - RAM);
    written = [];
  }
  answers.push(report());
  console.log(answers.join('\n'));
}

function program(image) {
  mcu.sram.fill(0);
  mcu.sram.set(readFileSync(image));
  core.VTOR = RAM;
  core.reset();
  core.LR = 0xffffffff;
  const lines = [];
  let hash = 0x811c9dc5;
  for (let count = 0; count < MOST_INSTRUCTIONS; count++) {
    const word = mcu.readUint16(core.PC);
    if (word === WFI || count % LINE === 0) {
      lines.push(`${count} ${core.cycles} ${hex(core.PC)} ${hex(hash)}`);
    }
    if (word === WFI) {
      lines.push(report());
      console.log(lines.join('\n'));
      return;
    }
    step();
    for (let number = 0; number < 16; number++) hash = Math.imul(hash ^ core.registers[number], 0x01000193);
    hash = Math.imul(hash ^ flags(), 0x01000193);
  }
  throw new Error('the program does not end');
}

/** The bytes of a UF2 or ELF file, in flash. */
function loadFlash(path) {
  const file = readFileSync(path);
  const put = (address, bytes) => mcu.flash.set(bytes, address - FLASH);
  if (file.readUInt32LE(0) === ELF_MAGIC) {
    for (let number = 0; number < file.readUInt16LE(44); number++) {
      const header = file.readUInt32LE(28) + 32 * number;
      const [kind, offset, , physical, bytes] = [0, 4, 8, 12, 16].map((field) => file.readUInt32LE(header + field));
      if (kind === 1 && bytes) put(physical, file.subarray(offset, offset + bytes));
    }
  } else {
    for (let block = 0; block < file.length; block += 512) {
      const bytes = file.readUInt32LE(block + 16);
      put(file.readUInt32LE(block + 12), file.subarray(block + 32, block + 32 + bytes));
    }
  }
  core.VTOR = FLASH + 0x100;
  core.reset();
  core.LR = 0xffffffff;
}

function firmware(image) {
  loadFlash(image);
  const events = readFileSync(0, 'utf8').trim().split('\n').map((line) => line.split(' '));
  let at = 0;
  const next = (kind) => {
    if (events[at]?.[0] !== kind) throw new Error(`line ${at}: ${events[at]}, where rp2040js has ${kind}`);
    return events[at++];
  };
  // Instructions come from memory; what they load from the other side; what they store goes to memory only.
  const isRam = (address) => address >= RAM && address < RAM + mcu.sram.length;
  let fetches = 0;
  let returning = false;
  let loads = 0;
  const load = (mask) => {
    loads++;
    return (parseInt(next('v')[1], 16) & mask) >>> 0;
  };
  core.readUint32 = (address) => (returning ? mcu.readUint32(address) : load(0xffffffff));
  core.readUint8 = () => load(0xff);
  const isWide = (word) => word >> 12 === 0b1111 || word >> 11 === 0b11101;
  core.readUint16 = (address) => {
    if (fetches > 0) {
      const word = mcu.readUint16(address);
      fetches = fetches === 2 && isWide(word) ? 1 : 0;
      return word;
    }
    return load(0xffff);
  };
  for (const bytes of [1, 2, 4]) {
    const name = `writeUint${8 * bytes}`;
    core[name] = (address, value) => {
      if (isRam(address >>> 0)) mcu[name](address >>> 0, value);
    };
  }
  core.checkForInterrupts = () => false;
  // A return: back to what was interrupted; or, if another exception follows it, only as far as that one's vector.
  const unstack = core.exceptionReturn.bind(core);
  let count = 0;
  let exceptions = 0;
  let chained = 0;
  core.exceptionReturn = (value) => {
    const follows = (event) => event?.[0] === 't' && Number(event[1]) === count + 1;
    if (follows(events[at]) || (events[at]?.[0] === 'h' && follows(events[at + 1]))) {
      core.LR = (0xf0000000 | value) >>> 0;
      core.PC -= 2;
      return;
    }
    returning = true;
    unstack(value);
    returning = false;
  };
  let hash = 0x811c9dc5;
  while (at < events.length) {
    const [kind, when, exception, vector] = events[at];
    if (kind === 'x' && Number(when) === count) {
      at++;
      exceptions++;
      const read = core.readUint32;
      core.readUint32 = () => (parseInt(vector, 16) & ~1) >>> 0;
      core.exceptionEntry(Number(exception));
      core.readUint32 = read;
      continue;
    }
    if (kind === 't' && Number(when) === count) {
      at++;
      chained++;
      core.IPSR = Number(exception);
      core.PC = (parseInt(vector, 16) & ~1) >>> 0;
      continue;
    }
    if (kind === 'h' && Number(when) === count) {
      if (hex(hash) !== events[at][2]) throw new Error(`before instruction ${count}: other registers or flags`);
      at++;
      continue;
    }
    core.waiting = false;
    core.interruptsUpdated = false;
    fetches = 2;
    step();
    count++;
    for (let number = 0; number < 16; number++) hash = Math.imul(hash ^ core.registers[number], 0x01000193);
    hash = Math.imul(hash ^ flags(), 0x01000193);
  }
  console.log(`${count} instructions, ${loads} loads, ${exceptions} exceptions, ${chained} of them chained`);
  console.log(report());
}

function usb(image) {
  loadFlash(image);
  const cdc = new USBCDC(mcu.usbCtrl);
  const back = [];
  let connected = false;
  // It forgets a buffer that the device has given it before it knew the endpoints: reminded of it here.
  const early = new Map();
  const { onEndpointRead } = mcu.usbCtrl;
  mcu.usbCtrl.onEndpointRead = (endpoint, size) => {
    if (cdc.outEndpoint < 0) early.set(endpoint, size);
    else onEndpointRead(endpoint, size);
  };
  cdc.onDeviceConnected = () => {
    connected = true;
    if (early.has(cdc.outEndpoint)) onEndpointRead(cdc.outEndpoint, early.get(cdc.outEndpoint));
  };
  cdc.onSerialData = (data) => back.push(...data);
  let sent = 0;
  for (let count = 0; count < MOST_INSTRUCTIONS && back.length < USB_BYTES; count++) {
    // Its queue holds 512 bytes.
    if (connected && sent < USB_BYTES && cdc.txFIFO.itemCount < 64) cdc.sendSerialByte(usbByte(sent++));
    mcu.clock.tick(core.executeInstruction() * 8);
    // It would take an interrupt that PRIMASK keeps out (B1.5.17): `wfi` goes on at once.
    core.waiting = false;
  }
  console.log(`${connected ? 'Open' : 'Enumerating'} ${back.map((byte) => hex(byte, 2)).join('')}`);
}

const [mode, image] = process.argv.slice(3);
if (mode === 'instructions') instructions();
else if (mode === 'program') program(image);
else if (mode === 'firmware') firmware(image);
else usb(image);
