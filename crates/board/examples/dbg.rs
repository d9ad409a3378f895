use pulsetrain_board::virtual_uno::VirtualUno;
use pulsetrain_board::{Link, Port};
use std::time::Duration;
fn main() {
    let mut uno = VirtualUno::new();
    let mut link = Link::new(7);
    link.hello(uno.now());
    for _ in 0..200 {
        let mut out = Vec::new();
        link.output(uno.now(), &mut out);
        if !out.is_empty() { println!("{:?} -> {out:02x?}", uno.now()); }
        uno.send(&out).unwrap();
        let mut back = Vec::new();
        let t = uno.now() + Duration::from_millis(5);
        uno.receive(t, &mut back).unwrap();
        if !back.is_empty() { println!("{:?} <- {back:02x?}", uno.now()); }
        link.input(&back, uno.now());
        if let Some(a) = link.answer() { println!("{a:?}"); break; }
    }
    let r=uno.chip().ram(); println!("rx {:02x?}", &r[0..256]); println!("ring {:02x?}", &r[256..300]); let mut c=uno.chip().clone(); for a in [0xc0u16,0xc1,0xc2,0xc4,0xc5,0x46,0x81,0x6f,0x6e]{ println!("{a:#x}={:#x}", c.read_data(a,&mut ())); }
    println!("zero {:?} pc {:#x} asleep {} {:?}", uno.zero(), uno.chip().pc()*2, uno.chip().is_asleep(), uno.chip().odd());
}
