//! Planning, for developers: `cargo bench -p pulsetrain-plan --bench planning` compares with the run before.
#![allow(clippy::disallowed_methods, reason = "what benches compute may differ in the last digit")]

#[path = "../tests/it/common/mod.rs"]
mod common;

use common::laws::{sine, trapezoid, waves};
use common::{lorenz::lorenz, settings};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use pulsetrain_motion::{Law, Time};
use pulsetrain_plan::{Planner, Settings};

fn planning(criterion: &mut Criterion) {
    let laws = [
        ("sine", sine(2000.0, Time::SECOND, 1), 16),
        ("fast sine", sine(2e6, Time::from_ratio(10, 1), 1), 24),
        ("trapezoid", trapezoid(180_000.0, 20_000.0, 20_000.0), 24),
        ("lorenz", lorenz(500.0, 20.0), 24),
        ("formula", waves(1000.0, &[(300.0, 7.0), (50.0, 31.0)], 20.0), 16),
    ];
    for packed in [false, true] {
        let mut group = criterion.benchmark_group(if packed { "packed" } else { "full resolution" });
        for (name, law, fraction_bits) in &laws {
            let settings = Settings { packed, ..settings((16_000_000, *fraction_bits)) };
            group.throughput(Throughput::Elements(plan(law, &settings)));
            group.bench_function(*name, |bencher| bencher.iter(|| plan(law, &settings)));
        }
        group.finish();
    }
}

/// Plans `law`; gives back the number of its steps.
fn plan(law: &Law, settings: &Settings) -> u64 {
    let mut planner = Planner::new(law, settings).expect("a tolerance that can be met");
    while planner.next_move().expect("a plan").is_some() {}
    planner.certificate().steps
}

criterion_group!(benches, planning);
criterion_main!(benches);
