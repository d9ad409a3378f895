//! Images: what is read, and that a broken file is refused with what is wrong, never loaded in part.

use proptest::prelude::*;
use pulsetrain_emulator::image::{ImageError, Piece, elf, flat, uf2};

const RP2040: u32 = 0xe48b_ff56;

/// An ELF file: segments of (type, physical address, bytes).
fn elf_file(segments: &[(u32, u32, &[u8])]) -> Vec<u8> {
    let mut file = b"\x7fELF\x01\x01\x01".to_vec();
    file.resize(16, 0);
    for half in [2_u16, 40] {
        file.extend(half.to_le_bytes());
    }
    // Version, entry, program headers at 52, no sections, flags.
    for word in [1_u32, 0, 52, 0, 0] {
        file.extend(word.to_le_bytes());
    }
    for half in [52, 32, segments.len() as u16, 40, 0, 0] {
        file.extend(half.to_le_bytes());
    }
    let mut offset = 52 + 32 * segments.len() as u32;
    for (kind, address, bytes) in segments {
        let length = bytes.len() as u32;
        // The virtual address is where start-up code copies it.
        for word in [*kind, offset, 0x2000_0000, *address, length, length + 100, 5, 4] {
            file.extend(word.to_le_bytes());
        }
        offset += length;
    }
    for (_, _, bytes) in segments {
        file.extend(*bytes);
    }
    file
}

#[test]
fn elf_segments_at_physical_addresses() {
    let file = elf_file(&[(1, 0x1000_0000, &[1, 2, 3]), (4, 0, &[9]), (1, 0x2000_0000, &[]), (1, 0x1000_0100, &[4])]);
    let pieces = elf(&file).expect("an image");
    let expected =
        [Piece { address: 0x1000_0000, bytes: vec![1, 2, 3] }, Piece { address: 0x1000_0100, bytes: vec![4] }];
    assert_eq!(pieces, expected);
    let memory = flat(&pieces, 0x1000_0000, 0x200).expect("it fits");
    assert_eq!((memory.len(), &memory[..4], memory[0x100]), (0x101, &[1, 2, 3, 0xff][..], 4));

    for length in 0..file.len() {
        let error = elf(&file[..length]).expect_err("cut off");
        assert!(length < 4 || length < 6 || matches!(error, ImageError::CutOff { .. }), "{length}: {error}");
    }
    assert_eq!(elf(&elf_file(&[(2, 0, &[1])])), Err(ImageError::Empty));
    let mut other = file.clone();
    other[18] = 83;
    assert_eq!(elf(&other), Err(ImageError::OtherProcessor));
    let mut wild = file;
    wild[28..32].copy_from_slice(&[0xff; 4]);
    assert!(matches!(elf(&wild), Err(ImageError::CutOff { what: "a program header", .. })));
}

/// A block: address, data, number, of how many, flags, family.
fn block(address: u32, data: &[u8], number: u32, of: u32, flags: u32, family: u32) -> Vec<u8> {
    let mut block = Vec::new();
    for word in [0x0a32_4655, 0x9e5d_5157, flags, address, data.len() as u32, number, of, family] {
        block.extend(u32::to_le_bytes(word));
    }
    block.extend(data);
    block.resize(508, 0);
    block.extend(0x0ab1_6f30_u32.to_le_bytes());
    block
}

#[test]
fn uf2_blocks() {
    let first = block(0x1000_0000, &[1; 256], 0, 2, 0x2000, RP2040);
    let second = block(0x1000_0100, &[2; 256], 1, 2, 0x2000, RP2040);
    let other = block(0x1000_0000, &[3; 256], 0, 1, 0x2000, 1234);
    let comment = block(0, &[4; 10], 0, 1, 1, 0);
    let file = [other.clone(), first.clone(), comment, second.clone()].concat();
    let memory = flat(&uf2(&file, RP2040).expect("an image"), 0x1000_0000, 512).expect("it fits");
    assert_eq!(memory, [[1; 256], [2; 256]].concat());

    assert_eq!(uf2(&other, RP2040), Err(ImageError::Empty));
    assert_eq!(uf2(&[], RP2040), Err(ImageError::Empty));
    assert_eq!(uf2(&first[..511], RP2040), Err(ImageError::Uf2Length { length: 511 }));
    let missing = ImageError::Uf2Order { block: 0, number: 1, of: 2, before: 0 };
    assert_eq!(uf2(&second, RP2040), Err(missing));
    assert!(matches!(uf2(&first, RP2040), Err(ImageError::Uf2Order { of: 2, .. })), "the second is missing");
    for (at, value) in [(0, 0), (4, 0), (508, 0), (17, 2)] {
        let mut broken = [first.clone(), second.clone()].concat();
        broken[512 + at] = value;
        assert_eq!(uf2(&broken, RP2040), Err(ImageError::Uf2Block { block: 1 }), "byte {at}");
    }
}

proptest! {
    /// Damaged files are refused or loaded, and what is loaded lies within the limit.
    #[test]
    fn damaged_files(changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..20), cut in 0..600_usize) {
        let elf_file = elf_file(&[(1, 0x1000_0000, &[1; 300]), (1, 0x1000_0200, &[2; 50])]);
        let uf2_file = [
            block(0x1000_0000, &[1; 256], 0, 2, 0x2000, RP2040),
            block(0x1000_0100, &[2; 256], 1, 2, 0x2000, RP2040),
        ].concat();
        for mut file in [elf_file, uf2_file] {
            for (at, byte) in &changes {
                let at = at.index(file.len());
                file[at] = *byte;
            }
            file.truncate(file.len().saturating_sub(cut));
            for pieces in [elf(&file), uf2(&file, RP2040)].into_iter().flatten() {
                let end = |piece: &Piece| u64::from(piece.address) + piece.bytes.len() as u64;
                let fits = pieces.iter().all(|piece| piece.address >= 0x1000_0000 && end(piece) <= 0x1000_1000);
                let memory = flat(&pieces, 0x1000_0000, 4096);
                prop_assert_eq!(memory.is_ok(), fits);
                prop_assert!(memory.is_ok_and(|memory| memory.len() <= 4096) || !fits);
            }
        }
    }
}
