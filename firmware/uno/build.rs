//! Hands the linker the memory map.

fn main() {
    // As src/memory.rs has them; memory.ld compares.
    let (pool, least_stack) = if std::env::var_os("CARGO_FEATURE_VERBS").is_some() { (368, 270) } else { (396, 245) };
    let folder = std::env::var("CARGO_MANIFEST_DIR").unwrap_or_default();
    println!("cargo::rerun-if-changed=memory.ld");
    println!("cargo::rustc-link-arg-bins={folder}/memory.ld");
    println!("cargo::rustc-link-arg-bins=-Wl,--defsym=least_stack={least_stack}");
    // Vectors and start-up are src/vectors.rs.
    println!("cargo::rustc-link-arg-bins=-nostartfiles");
    // Calls and jumps in two bytes where they reach.
    println!("cargo::rustc-link-arg-bins=-Wl,--relax");
    // RAM begins with pages of their own and the queues: see src/memory.rs.
    println!("cargo::rustc-link-arg-bins=-Wl,--section-start=.pages=0x800100");
    println!("cargo::rustc-link-arg-bins=-Wl,--section-start=.data={:#x}", 0x80_0400 + pool);
}
