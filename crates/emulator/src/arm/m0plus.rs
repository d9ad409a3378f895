//! The Cortex-M0+: what it does not share with the other processors (ARMv6-M ARM DDI 0419E; TRM DDI 0484C). Its
//! instructions are in `execute`.

use super::bus::{Bus, Size};
use super::cpu::{Config, Core, Cpu};
use super::decode::{HALF_WORDS, Op, TABLE};
use super::fault::FaultCause;
use super::nvic::HARD_FAULT;
use super::variant::{Variant, private};

/// The part of a Cortex-M0+ that other processors do not have: the table of its instructions.
#[derive(Clone, Copy)]
pub struct M0Plus(&'static [Op; HALF_WORDS]);

impl private::Sealed for M0Plus {}

impl Variant for M0Plus {
    const PRIORITY_BITS: u8 = 0xc0;
    const VECTOR_TABLE_BITS: u32 = !0xff;
    const EXCEPTION_BITS: u32 = 0x3f;
    /// TRM §3.6.1 gives the sum of the two, 15.
    const STACKING: u64 = 12;
    const VECTOR: u64 = 3;
    const TAIL_CHAIN: u64 = Self::VECTOR;
    const READS_VECTOR_EARLY: bool = false;
    /// As `pop` with eight registers, 3 + 8 (TRM table 3-1).
    const UNSTACKING: u64 = 11;

    #[inline(always)]
    fn instruction(core: &mut Core<Self>, bus: &mut impl Bus) {
        let began = core.cycle;
        core.instructions += 1;
        match bus.fetch(core.pc, core.cycle) {
            Ok(word) => {
                core.cycle += u64::from(bus.wait_cycles());
                if let Err(cause) = core.execute(core.variant.0[usize::from(word)], bus) {
                    core.cycle = core.cycle.max(began + 1);
                    core.take_fault(cause);
                }
            }
            Err(fault) => {
                core.cycle += 1;
                core.take_fault(FaultCause::Fetch { address: fault.address });
            }
        }
    }

    fn fault_exception(_: &mut Core<Self>, _: FaultCause) -> u32 {
        HARD_FAULT
    }

    fn may_access(core: &Core<Self>, _: u32, size: Size) -> bool {
        size == Size::Word && core.is_privileged()
    }
}

impl Cpu {
    /// A processor before its reset, at cycle 0: [`reset`](Core::reset) starts it.
    pub fn new(config: Config) -> Cpu {
        Core::with(config, M0Plus(&TABLE))
    }

    /// Sets the levels of the 32 interrupt lines. A rising line makes its interrupt pending. A line that is still high
    /// when its handler returns makes it pending again (ARMv6-M ARM §B3.4.1).
    #[inline]
    pub fn set_irq_lines(&mut self, levels: u32) {
        self.set_lines(levels.into());
    }
}
