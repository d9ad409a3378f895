//! What comes before main: vectors, the copy to RAM, the stack; and cells for statics.

use core::arch::global_asm;

/// The second stage of the boot ROM's start-up (§2.8.1): sets up the flash for reading by its slowest command, which all
/// flash chips know. That is fast enough: the program is copied to RAM once.
#[used]
#[unsafe(link_section = ".boot2")]
static BOOT2: [u8; 256] = rp2040_boot2::BOOT_LOADER_GENERIC_03H;

// Vectors (ARMv6-M, B1.5.3; interrupts: RP2040 datasheet §2.3.2), which are copied to RAM too, and the first instructions. The
// firmware enables only the DMA's interrupt; a program that uses the library also the timer's, and its own: see `set_handler`. Any
// other is a fault, and ends the program.
global_asm!(
    r#"
    .section .vectors, "a", %progbits
vectors:
    .word stack_top
    .word reset
    .word fault                 @ NMI
    .word fault                 @ HardFault
    .rept 3
    .word 0
    .endr
    .word 0                     @ 7, which the processor does not use: where a baked motion is (pulsetrain_core::baked::POINTER)
    .rept 3
    .word 0
    .endr
    .word fault                 @ SVCall
    .rept 2
    .word 0
    .endr
    .word fault                 @ PendSV
    .word fault                 @ SysTick
    .rept 11
    .word fault
    .endr
    .word dma_irq_0             @ 11
    .rept 20
    .word fault
    .endr

    .section .bss.vectors, "aw", %nobits
    .balign 256
    .global ram_vectors
ram_vectors:
    .space 4 * {VECTORS}

    .section .reset, "ax", %progbits
    .global reset
    .type reset, %function
    .thumb_func
reset:
    cpsid i
    ldr r0, =ram_start
    ldr r1, =ram_end
    ldr r2, =ram_load
1:  cmp r0, r1
    bhs 2f
    ldmia r2!, {{r3}}
    stmia r0!, {{r3}}
    b 1b
2:  ldr r0, =bss_start
    ldr r1, =bss_end
    movs r3, #0
3:  cmp r0, r1
    bhs 4f
    stmia r0!, {{r3}}
    b 3b
4:  ldr r0, =ram_vectors        @ from where interrupts take them from now on (ARMv6-M, B3.2.5)
    ldr r1, =vectors
    ldr r2, =ram_vectors + 4 * {VECTORS}
6:  ldmia r1!, {{r3}}
    stmia r0!, {{r3}}
    cmp r0, r2
    blo 6b
    ldr r0, ={VTOR}
    ldr r1, =ram_vectors
    str r1, [r0]
    ldr r0, =stack_bottom
    ldr r1, =stack_top
    ldr r3, ={STACK_FILL}
5:  stmia r0!, {{r3}}
    cmp r0, r1
    blo 5b
    ldr r0, =main
    blx r0
    .pool
    .size reset, . - reset
    "#,
    STACK_FILL = const STACK_FILL,
    VECTORS = const VECTORS,
    VTOR = const 0xe000_ed08_u32,
);

/// Vectors: 16 of the processor, 32 of interrupts.
const VECTORS: usize = 48;

/// The stack is filled with this word before it is used, so that one can see how much was used.
const STACK_FILL: u32 = 0xa5a5_a5a5;

unsafe extern "C" {
    static stack_bottom: [u32; STACK_BYTES / 4];
}

/// Bytes of the stack, as in memory.ld.
const STACK_BYTES: usize = 16_384;

/// Bytes of the stack that were never used.
pub(crate) fn stack_left() -> u16 {
    // SAFETY: the linker's symbol is where the stack's memory begins, of which only what lies above the stack pointer changes
    // meanwhile; each word is read as the machine has it.
    let words = (0..STACK_BYTES / 4)
        .take_while(|word| unsafe { (&raw const stack_bottom[*word]).read_volatile() } == STACK_FILL);
    (words.count() * 4) as u16
}

unsafe extern "C" {
    /// The vectors in RAM, which the processor uses.
    static mut ram_vectors: [u32; VECTORS];
}

/// Sets the handler of interrupt `number` (§2.3.2), which is not enabled yet.
pub(crate) fn set_handler(number: usize, handler: extern "C" fn()) {
    // SAFETY: a word of the table; the processor reads it only when that interrupt comes.
    unsafe { (&raw mut ram_vectors[16 + number]).write_volatile(handler as usize as u32) }
}

/// A static value that main takes once.
pub(crate) struct StaticCell<T>(core::cell::UnsafeCell<T>);

// SAFETY: `take` hands it out once; its owner does not share it, or shares what it is part of by `Shared`.
unsafe impl<T> Sync for StaticCell<T> {}

impl<T> StaticCell<T> {
    /// `value`, to be taken.
    pub(crate) const fn new(value: T) -> StaticCell<T> {
        StaticCell(core::cell::UnsafeCell::new(value))
    }

    /// Takes it.
    ///
    /// # Safety
    /// Only once.
    #[expect(clippy::mut_from_ref, reason = "only once")]
    pub(crate) unsafe fn take(&'static self) -> &'static mut T {
        // SAFETY: the caller's promise.
        unsafe { &mut *self.0.get() }
    }
}

/// A static value that main and one interrupt use in turn.
pub(crate) struct Shared<T>(core::cell::UnsafeCell<T>);

// SAFETY: the callers of `with` promise that nobody else uses it meanwhile.
unsafe impl<T> Sync for Shared<T> {}

impl<T> Shared<T> {
    /// `value`, to be used by `with`.
    pub(crate) const fn new(value: T) -> Shared<T> {
        Shared(core::cell::UnsafeCell::new(value))
    }

    /// Calls `f` with it.
    ///
    /// # Safety
    /// Nobody else uses it until `f` returns: the interrupt is disabled, or it is the caller; and `f` does not call this.
    pub(crate) unsafe fn with<U>(&self, f: impl FnOnce(&mut T) -> U) -> U {
        // SAFETY: the caller's promise.
        f(unsafe { &mut *self.0.get() })
    }
}
