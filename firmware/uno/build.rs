//! Hands the linker the memory map.

/// Programs: bytes of the queues, as `Program::POOL` has them, and of stack, at least (src/engine/memory.rs). memory.ld compares.
const PROGRAMS: [(&str, u32, u32); 4] =
    [("uno", 376, 245), ("uno-winch", 396, 235), ("uno-verbs", 366, 270), ("uno-baked", 396, 245)];

fn main() {
    let folder = std::env::var("CARGO_MANIFEST_DIR").unwrap_or_default();
    println!("cargo::rerun-if-changed=memory.ld");
    println!("cargo::rustc-link-arg-bins={folder}/memory.ld");
    // Vectors and start-up are src/engine/vectors.rs.
    println!("cargo::rustc-link-arg-bins=-nostartfiles");
    // Calls and jumps in two bytes where they reach.
    println!("cargo::rustc-link-arg-bins=-Wl,--relax");
    // RAM begins with pages of their own and the queues: see src/engine/memory.rs.
    println!("cargo::rustc-link-arg-bins=-Wl,--section-start=.pages=0x800100");
    let out = std::env::var_os("OUT_DIR").unwrap_or_default();
    for (program, queues, stack) in PROGRAMS {
        // In a script of its own: a symbol of the command line is nothing to an ASSERT.
        let script = std::path::Path::new(&out).join(format!("{program}.ld"));
        let assert = format!(
            "ASSERT(_end <= 0x800900 - {stack}, \"pulsetrain: less than {stack} bytes are left for the stack of {program}; \
             see the table in src/engine/memory.rs\")\n"
        );
        std::fs::write(&script, assert).expect("cargo's own folder can be written");
        println!("cargo::rustc-link-arg-bin={program}={}", script.display());
        println!("cargo::rustc-link-arg-bin={program}=-Wl,--section-start=.data={:#x}", 0x80_0400 + queues);
    }
}
