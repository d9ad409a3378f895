"""Runs ARMv7-M instructions in Unicorn's Cortex-M3 and prints what they did, in the lines that the emulator's example
`cross_check_arm m3` prints too (it says what they are). Unicorn has the GPL: it runs here, and is no part of what the
project distributes.

An instance that has raised an error is not used again: what it executes afterwards cannot be relied on.

Bit-band aliases, which Unicorn does not have, are stated here a second time (DDI 0337, "Bit-banding").

The last line is `met NAME=TIMES...`: how often it was put right where Unicorn 2.1.4 is not the manual's (ARM DDI 0403E):

STACK    Bits 1 and 0 of the stack pointers stay as they are written (B1.4.1: they are 0).
BLOCK    The state of an IT block is left as it was somewhere within it, when its end is reached (A7.3.1: it is 0).
"""

import sys

from unicorn import (
    UC_ARCH_ARM,
    UC_HOOK_MEM_WRITE,
    UC_MODE_MCLASS,
    UC_MODE_THUMB,
    UC_PROT_EXEC,
    Uc,
    UcError,
)
from unicorn import arm_const as arm

RAM = 0x2000_0000
RAM_BYTES = 264 * 1024
ALIASES = 0x2200_0000
CODE = RAM + 0x8000
# Where code may be, besides RAM.
CODE_WINDOW = 0x1E00_0000
CODE_WINDOW_END = 0x2200_0000
FLAGS = 0xFE00_FC00
BLOCK = 0x0600_FC00
REGISTERS = [*range(arm.UC_ARM_REG_R0, arm.UC_ARM_REG_R0 + 13), arm.UC_ARM_REG_SP, arm.UC_ARM_REG_LR]
STACK_POINTERS = (arm.UC_ARM_REG_SP, arm.UC_ARM_REG_MSP, arm.UC_ARM_REG_PSP)

FRESH = bytes((address * 0x9E37_79B1 & 0xFFFF_FFFF) >> 24 for address in range(RAM, RAM + RAM_BYTES))


class Processor:
    met = {"STACK": 0, "BLOCK": 0}

    def __init__(self):
        self.uc = Uc(UC_ARCH_ARM, UC_MODE_THUMB | UC_MODE_MCLASS)
        self.uc.ctl_set_cpu_model(arm.UC_CPU_ARM_CORTEX_M3)
        # Memory is fetched, read and written alike.
        self.uc.mem_map(RAM, RAM_BYTES)
        self.uc.mem_write(RAM, FRESH)
        # Branches may go here; what would be executed next is fetched.
        self.uc.mem_map(CODE_WINDOW, RAM - CODE_WINDOW, UC_PROT_EXEC)
        self.uc.mem_map(RAM + RAM_BYTES, CODE_WINDOW_END - RAM - RAM_BYTES, UC_PROT_EXEC)
        self.written = set()
        self.uc.hook_add(UC_HOOK_MEM_WRITE, self.write)

        self.uc.mmio_map(ALIASES, 32 * RAM_BYTES, self.read_bit, None, self.write_bit, None)

    def read_bit(self, _uc, offset, _size, _data):
        (byte,) = self.uc.mem_read(RAM + offset // 32, 1)
        return byte >> offset // 4 % 8 & 1

    def write_bit(self, _uc, offset, _size, value, _data):
        address, place = RAM + offset // 32, offset // 4 % 8
        (byte,) = self.uc.mem_read(address, 1)
        self.uc.mem_write(address, bytes([byte & ~(1 << place) | (value & 1) << place]))
        self.written.add(address)

    def write(self, _uc, _kind, address, size, _value, _data):
        if not ALIASES <= address < ALIASES + 32 * RAM_BYTES:
            self.written.update(range(address, address + size))

    def read(self, register):
        value = self.uc.reg_read(register)
        if register in STACK_POINTERS and value & 3 != 0:
            self.met["STACK"] += 1
            value &= ~3
        return value

    def run(self, count, code, xpsr, registers):
        """Returns what happened, or None if Unicorn refuses to execute it."""
        uc = self.uc
        self.written.clear()
        uc.mem_write(CODE, b"".join(half.to_bytes(2, "little") for half in code))
        uc.ctl_remove_cache(CODE, CODE + 64)
        for register in (arm.UC_ARM_REG_PRIMASK, arm.UC_ARM_REG_BASEPRI, arm.UC_ARM_REG_FAULTMASK):
            uc.reg_write(register, 0)
        uc.reg_write(arm.UC_ARM_REG_CONTROL, 0)
        uc.reg_write(arm.UC_ARM_REG_PSP, 0)
        for register, value in zip(REGISTERS, registers):
            uc.reg_write(register, value)
        uc.reg_write(arm.UC_ARM_REG_XPSR, xpsr | 1 << 24)
        try:
            if count == 1:
                uc.emu_start(CODE | 1, 0, 0, 1)
            else:
                # Within an IT block Unicorn's count is not exact. What is executed here has no branches.
                uc.emu_start(CODE | 1, CODE + 2 * (len(code) - 1))
        except UcError:
            return None
        flags = uc.reg_read(arm.UC_ARM_REG_XPSR) & FLAGS
        if count > 1 and flags & BLOCK != 0:
            self.met["BLOCK"] += 1
            flags &= ~BLOCK
        answer = f"{uc.reg_read(arm.UC_ARM_REG_PC) & ~1:08x} {flags:08x} "
        answer += "".join(f"{self.read(register):08x}" for register in REGISTERS)
        for register in (arm.UC_ARM_REG_PRIMASK, arm.UC_ARM_REG_BASEPRI, arm.UC_ARM_REG_FAULTMASK):
            answer += f" {uc.reg_read(register):x}"
        for register in (arm.UC_ARM_REG_MSP, arm.UC_ARM_REG_PSP):
            answer += f" {self.read(register):08x}"
        answer += f" {uc.reg_read(arm.UC_ARM_REG_CONTROL) & 2}"
        for address in sorted(self.written):
            (byte,) = uc.mem_read(address, 1)
            if byte != FRESH[address - RAM]:
                answer += f" {address:x}={byte:x}"
            uc.mem_write(address, FRESH[address - RAM : address - RAM + 1])
        uc.mem_write(CODE, FRESH[CODE - RAM : CODE - RAM + 64])
        return answer


def main():
    processor = Processor()
    for line in sys.stdin:
        count, code, xpsr, registers = line.split()
        halves = [int(half, 16) for half in code.split(",")]
        values = [int(registers[at : at + 8], 16) for at in range(0, 120, 8)]
        answer = processor.run(int(count, 16), halves, int(xpsr, 16), values)
        if answer is None:
            answer = "fault"
            processor = Processor()
        print(answer)
    print("met", " ".join(f"{name}={times}" for name, times in Processor.met.items()))


main()
