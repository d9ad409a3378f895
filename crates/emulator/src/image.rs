//! Program images for chips whose memory is at high addresses: ELF as compilers write it, UF2 as boards with a USB boot
//! loader take it. Images for the AVR are in [`crate::hex`].

use thiserror::Error;

/// Bytes, and the address at which they belong.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Piece {
    /// Address of the first byte.
    pub address: u32,
    /// The bytes.
    pub bytes: Vec<u8>,
}

/// Why a file cannot be loaded as an image.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum ImageError {
    /// The file does not begin as an ELF file does.
    #[error("not an ELF file: it does not begin with 7f 45 4c 46")]
    NotElf,
    /// An ELF file for another kind of processor.
    #[error("an ELF file for another processor: wanted are 32 bits, little endian, machine 40 (Arm)")]
    OtherProcessor,
    /// A header points beyond the end of the file.
    #[error("the file is cut off: {what} ends at byte {end}, the file at {length}")]
    CutOff {
        /// What was to be read.
        what: &'static str,
        /// The byte at which it would end.
        end: u64,
        /// Length of the file, bytes.
        length: usize,
    },
    /// The length is not a multiple of 512 bytes, the size of a UF2 block.
    #[error("{length} bytes are no whole number of UF2 blocks of 512 bytes")]
    Uf2Length {
        /// Length of the file, bytes.
        length: usize,
    },
    /// A block has the wrong magic numbers, or more data than fits.
    #[error("block {block} is not a UF2 block")]
    Uf2Block {
        /// The block, from 0.
        block: usize,
    },
    /// Blocks are missing, or come from different files.
    #[error("block {block} says that it is block {number} of {of}, after {before} others")]
    Uf2Order {
        /// The block, from 0.
        block: usize,
        /// The number that the block contains.
        number: u32,
        /// The number of blocks that the block contains.
        of: u32,
        /// How many blocks came before it.
        before: u32,
    },
    /// Nothing in the file is to be loaded.
    #[error("nothing in the file is to be loaded")]
    Empty,
    /// A piece is outside the memory that the image is for.
    #[error("{bytes} bytes at {address:#010x} do not fit into memory from {base:#010x} with {limit} bytes")]
    Outside {
        /// Address of the piece.
        address: u32,
        /// Length of the piece, bytes.
        bytes: usize,
        /// Address of the memory.
        base: u32,
        /// Size of the memory, bytes.
        limit: usize,
    },
}

/// Reads the loadable segments of an ELF file for Arm, at their physical addresses. That is where they are stored, not
/// where start-up code copies them. Source: System V ABI, chapters 4 and 5.
///
/// # Errors
/// [`ImageError`]: not such a file, cut off, or nothing to load.
pub fn elf(file: &[u8]) -> Result<Vec<Piece>, ImageError> {
    const ARM: u16 = 40;
    const LOADABLE: u32 = 1;
    if !file.starts_with(b"\x7fELF") {
        return Err(ImageError::NotElf);
    }
    // Class 1: 32 bits. Encoding 1: little endian.
    if file.get(4..6) != Some(&[1, 1]) || half(file, 18, "the header")? != ARM {
        return Err(ImageError::OtherProcessor);
    }
    let (table, size) = (word(file, 28, "the header")?, half(file, 42, "the header")?);
    let count = half(file, 44, "the header")?;
    let mut pieces = Vec::new();
    for number in 0..u64::from(count) {
        let at = u64::from(table) + number * u64::from(size);
        let field = |offset| word(file, at + offset, "a program header");
        let (kind, offset, address, bytes) = (field(0)?, field(4)?, field(12)?, field(16)?);
        if kind == LOADABLE && bytes != 0 {
            let bytes = part(file, offset.into(), bytes.into(), "a segment")?.to_vec();
            pieces.push(Piece { address, bytes });
        }
    }
    if pieces.is_empty() { Err(ImageError::Empty) } else { Ok(pieces) }
}

/// Reads the blocks of a UF2 file that are for a family of chips (0xe48bff56: RP2040), or for no family in particular.
/// Source: github.com/microsoft/uf2, README.
///
/// # Errors
/// [`ImageError`]: not such a file, blocks missing, or none for this family.
pub fn uf2(file: &[u8], family: u32) -> Result<Vec<Piece>, ImageError> {
    const BLOCK: usize = 512;
    const MAGIC: [(u64, u32); 3] = [(0, 0x0a32_4655), (4, 0x9e5d_5157), (508, 0x0ab1_6f30)];
    const DATA: u64 = 32;
    const MOST_DATA: u32 = 476;
    const NOT_MAIN_FLASH: u32 = 1;
    const HAS_FAMILY: u32 = 0x2000;
    if !file.len().is_multiple_of(BLOCK) {
        return Err(ImageError::Uf2Length { length: file.len() });
    }
    let mut pieces = Vec::new();
    let mut before = 0;
    for (number, block) in file.chunks(BLOCK).enumerate() {
        let field = |offset| word(block, offset, "a block");
        for (offset, magic) in MAGIC {
            if field(offset)? != magic {
                return Err(ImageError::Uf2Block { block: number });
            }
        }
        let (flags, address, bytes, block_family) = (field(8)?, field(12)?, field(16)?, field(28)?);
        if flags & NOT_MAIN_FLASH != 0 || flags & HAS_FAMILY != 0 && block_family != family {
            continue;
        }
        if bytes > MOST_DATA {
            return Err(ImageError::Uf2Block { block: number });
        }
        let (index, of) = (field(20)?, field(24)?);
        if index != before || index >= of {
            return Err(ImageError::Uf2Order { block: number, number: index, of, before });
        }
        before += 1;
        pieces.push((of, Piece { address, bytes: part(block, DATA, bytes.into(), "a block")?.to_vec() }));
    }
    match pieces.last() {
        None => Err(ImageError::Empty),
        Some((of, _)) if *of != before => {
            Err(ImageError::Uf2Order { block: file.len() / BLOCK - 1, number: before - 1, of: *of, before: before - 1 })
        }
        Some(_) => Ok(pieces.into_iter().map(|(_, piece)| piece).collect()),
    }
}

/// Puts pieces into one image of the memory from `base` on, of at most `limit` bytes. Gaps are 0xff, as in erased
/// flash; the image ends with the last piece.
///
/// # Errors
/// [`ImageError::Outside`] names the piece that does not fit.
///
/// ```
/// use pulsetrain_emulator::image::{ImageError, Piece, flat};
/// let pieces = [Piece { address: 0x1000_0002, bytes: vec![1, 2] }];
/// assert_eq!(flat(&pieces, 0x1000_0000, 4), Ok(vec![0xff, 0xff, 1, 2]));
/// assert!(matches!(flat(&pieces, 0x1000_0000, 3), Err(ImageError::Outside { address: 0x1000_0002, .. })));
/// ```
pub fn flat(pieces: &[Piece], base: u32, limit: usize) -> Result<Vec<u8>, ImageError> {
    let mut memory = Vec::new();
    for Piece { address, bytes } in pieces {
        let outside = ImageError::Outside { address: *address, bytes: bytes.len(), base, limit };
        let start = address.checked_sub(base).ok_or(outside.clone())? as usize;
        let end = start.checked_add(bytes.len()).filter(|end| *end <= limit).ok_or(outside)?;
        if memory.len() < end {
            memory.resize(end, 0xff);
        }
        memory[start..end].copy_from_slice(bytes);
    }
    Ok(memory)
}

/// Makes a UF2 file from the contents of a memory from `base` on, for a family of chips. A block holds 256 bytes; zeros
/// fill up the last one. Source: github.com/microsoft/uf2, README.
///
/// ```
/// use pulsetrain_emulator::image::{flat, to_uf2, uf2};
/// let file = to_uf2(&[7; 300], 0x1000_0000, 0xe48b_ff56);
/// assert_eq!(file.len(), 2 * 512);
/// let memory = flat(&uf2(&file, 0xe48b_ff56).unwrap(), 0x1000_0000, 512).unwrap();
/// assert_eq!((memory[299], memory[300], memory.len()), (7, 0, 512));
/// ```
#[must_use]
pub fn to_uf2(memory: &[u8], base: u32, family: u32) -> Vec<u8> {
    const PAYLOAD: usize = 256;
    const HAS_FAMILY: u32 = 0x2000;
    let blocks = memory.chunks(PAYLOAD);
    let count = blocks.len() as u32;
    let mut file = Vec::new();
    for (number, bytes) in (0..).zip(blocks) {
        let address = base + number * PAYLOAD as u32;
        for word in [0x0a32_4655, 0x9e5d_5157, HAS_FAMILY, address, PAYLOAD as u32, number, count, family] {
            file.extend(word.to_le_bytes());
        }
        let mut data = [0; 476];
        data[..bytes.len()].copy_from_slice(bytes);
        file.extend(data);
        file.extend(0x0ab1_6f30_u32.to_le_bytes());
    }
    file
}

fn part<'a>(file: &'a [u8], at: u64, bytes: u64, what: &'static str) -> Result<&'a [u8], ImageError> {
    // Address and length come from 32-bit fields, so that the sum cannot overflow.
    let end = at + bytes;
    let range = usize::try_from(at).ok().zip(usize::try_from(end).ok()).and_then(|(at, end)| file.get(at..end));
    range.ok_or(ImageError::CutOff { what, end, length: file.len() })
}

fn half(file: &[u8], at: u64, what: &'static str) -> Result<u16, ImageError> {
    let bytes = part(file, at, 2, what)?;
    Ok(u16::from_le_bytes([bytes[0], bytes[1]]))
}

fn word(file: &[u8], at: u64, what: &'static str) -> Result<u32, ImageError> {
    let bytes = part(file, at, 4, what)?;
    Ok(u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]))
}
