use pulsetrain_board::virtual_uno::VirtualUno;
use pulsetrain_board::*;
use pulsetrain_core::wire::message::MotorSetup;
use pulsetrain_core::wire::Baud;
use pulsetrain_core::*;
fn main() {
    let mut remote = Remote::open(VirtualUno::new(), 7).unwrap();
    remote.set_baud(Baud::B1M).unwrap();
    let m = MotorSetup { step_pin: 8, dir_pin: 9, forward_high: true, pull_in_ticks: 160_000, ..MotorSetup::default() };
    let setup = Setup { pulse_ticks: 16, setup_ticks: 8, hold_ticks: 8, motors: vec![m], ..Setup::default() };
    remote.configure(&setup).unwrap();
    let show = |r: &Remote<VirtualUno>, w: &str| { let c = r.port().chip(); println!("{w}: cycle {} zero {:?} pc {:#x} lowest sp {:#x} odd {:?} masked {:?}", c.cycle(), r.port().zero(), c.pc()*2, c.lowest_sp(), c.odd(), c.longest_masked()); };
    show(&remote, "configured");
    let from = remote.now() + 800_000;
    let segment = Segment { count: 20, interval: 16000 << 16, add: 0, add2: 0 };
    for item in [Item::Anchor { tick: Moment::of(from) }, Item::Run { segment, direction: Direction::Forward }] {
        println!("{:?}", remote.push(0, Entry { epoch: Epoch(1), item }));
    }
    println!("{:?}", remote.switch(Epoch(1), from));
    show(&remote, "switched");
    for i in 0..20 { remote.advance(from + i * 40_000, &mut |e: Edge| println!("{e:?}")); 
    println!("{:?} {:?}", remote.error(), remote.positions()); }
    show(&remote, "end");
    let e = remote.events(); println!("{e:?}");
}
