//! Shows what Pulsetrain understands of OSC packets, without a motion: to try a patch of TouchDesigner or Max, or a layout of a phone.
//!
//! ```console
//! $ cargo run --example osc_monitor -- 9000                    # programs of this computer
//! $ cargo run --example osc_monitor -- 192.168.1.20:9000       # other computers and phones too
//! {"listens":"127.0.0.1:9000"}
//! {"in_ms":0,"requests":[{"command":"set","knob":"wildness","value":0.7}]}
//! ```
//!
//! It has two motors, `first` and `second`, and a knob, `wildness`. The positions of the motors are the number of groups of requests so far, and its negative. A stop ends it.

use std::error::Error;
use std::sync::mpsc::sync_channel;

use pulsetrain::live::{KnobInfo, MotorInfo, RunCommand, RunEvent};
use pulsetrain::osc::{Now, OscInfo, OscServer, OscSettings, listen_address};
use pulsetrain::session::control::{MotorStatus, Status};
use serde_json::json;

/// Groups of requests that may wait to be printed.
const MOST_WAITING: usize = 64;

fn main() -> Result<(), Box<dyn Error>> {
    let address = listen_address(&std::env::args().nth(1).unwrap_or_else(|| "9000".to_owned()))?;
    let motor = |name: &str| MotorInfo {
        name: name.to_owned(),
        unit: "deg".to_owned(),
        steps_per_unit: 10.0,
        start_steps: 0.0,
        max_speed: None,
    };
    let (name, target, unit) = ("wildness".to_owned(), "first.wildness".to_owned(), String::new());
    let knobs = vec![KnobInfo { name, target, unit, least: Some(0.0), greatest: Some(1.0), value: 0.0 }];
    let (sender, groups) = sync_channel(MOST_WAITING);
    let settings = OscSettings { address, reply_port: None };
    let server = OscServer::open(settings, OscInfo { motors: vec![motor("first"), motor("second")], knobs }, sender)?;
    println!("{}", json!({ "listens": server.address().to_string() }));
    let mut count = 0;
    let status = |count: i64| {
        let motor = |position| MotorStatus { position, target: None, speed: Some(0.0), queue: (0, 0) };
        let motors = vec![motor(count), motor(-count)];
        RunEvent::Status(Status { at_s: count as f64, lease_s: None, motors, lateness: None })
    };
    for group in groups {
        let in_ms = group.due.saturating_duration_since(Now::read().instant).as_millis();
        // A client that has read the line may ask for positions at once.
        count += 1;
        server.tell(&status(count));
        println!("{}", json!({ "in_ms": in_ms, "requests": group.requests }));
        let stops = |request: &RunCommand| request.is_stop();
        if group.requests.iter().any(stops) {
            break;
        }
    }
    println!("{:?}", server.counts());
    Ok(())
}
