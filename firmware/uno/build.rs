//! Hands the linker the memory map.

fn main() {
    // As src/memory.rs has them; memory.ld compares.
    let (pool, least_stack) = if std::env::var_os("CARGO_FEATURE_VERBS").is_some() { (368, 270) } else { (396, 245) };
    // Text is in the image that has nothing in its place.
    println!("cargo::rustc-check-cfg=cfg(text)");
    if ["VERBS", "BAKED", "STREAM"].iter().all(|feature| std::env::var_os(format!("CARGO_FEATURE_{feature}")).is_none())
    {
        println!("cargo::rustc-cfg=text");
    }
    let folder = std::env::var("CARGO_MANIFEST_DIR").unwrap_or_default();
    println!("cargo::rerun-if-changed=memory.ld");
    println!("cargo::rustc-link-arg-bins={folder}/memory.ld");
    // In a script of its own: a symbol of the command line is nothing to an ASSERT.
    let stack = std::path::Path::new(&std::env::var_os("OUT_DIR").unwrap_or_default()).join("stack.ld");
    let assert = format!(
        "ASSERT(_end <= 0x800900 - {least_stack}, \"pulsetrain: less than {least_stack} bytes are left for the stack; see \
         the table in src/memory.rs\")\n"
    );
    std::fs::write(&stack, assert).expect("cargo's own folder can be written");
    println!("cargo::rustc-link-arg-bins={}", stack.display());
    // Vectors and start-up are src/vectors.rs.
    println!("cargo::rustc-link-arg-bins=-nostartfiles");
    // Calls and jumps in two bytes where they reach.
    println!("cargo::rustc-link-arg-bins=-Wl,--relax");
    // RAM begins with pages of their own and the queues: see src/memory.rs.
    println!("cargo::rustc-link-arg-bins=-Wl,--section-start=.pages=0x800100");
    println!("cargo::rustc-link-arg-bins=-Wl,--section-start=.data={:#x}", 0x80_0400 + pool);
}
