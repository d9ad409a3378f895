//! A packed stream of any content: the decoder takes it or refuses it, and what it takes can be packed again.
#![no_main]

use libfuzzer_sys::fuzz_target;
use pulsetrain_core::packing::{MAX_PACKED_LEN, Packing, State};
use pulsetrain_core::{Item, Segment};

fuzz_target!(|input: (u8, i8, &[u8])| {
    let (fraction_bits, gain, mut bytes) = input;
    let packing = Packing { fraction_bits: u32::from(fraction_bits % 33), gain };
    let mut state = State::default();
    loop {
        let before = state;
        let Ok(Some(item)) = packing.unpack(&mut state, &mut bytes) else { break };
        let (mut sender, mut receiver) = (before, before);
        let mut packed = [0; MAX_PACKED_LEN];
        let len = packing.pack(&mut sender, &item, &mut packed).expect("an item that was unpacked can be packed");
        let again =
            packing.unpack(&mut receiver, &mut &packed[..len]).expect("an item that was packed can be unpacked");
        assert_eq!(again.map(as_run), Some(as_run(item)));
        assert_eq!(sender, receiver);
    }
});

/// The segment without the differences that none of its steps uses: those are not packed.
fn as_run(item: Item) -> Item {
    match item {
        Item::Run { segment, direction } => {
            let Segment { count, add, add2, .. } = segment;
            let (add, add2) = (if count > 1 { add } else { 0 }, if count > 2 { add2 } else { 0 });
            Item::Run { segment: Segment { add, add2, ..segment }, direction }
        }
        Item::Anchor { .. } | Item::Dwell { .. } => item,
    }
}
