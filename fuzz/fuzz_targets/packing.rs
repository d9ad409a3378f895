//! A packed stream of any content: the decoder takes it or refuses it, and what it takes can be packed again.
#![no_main]

use libfuzzer_sys::fuzz_target;
use pulsetrain_core::packing::{MAX_PACKED_LEN, Packing, State};

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
        let again = packing.unpack(&mut receiver, &mut &packed[..len]);
        assert_eq!(again, Ok(Some(item)));
        assert_eq!(sender, receiver);
    }
});
