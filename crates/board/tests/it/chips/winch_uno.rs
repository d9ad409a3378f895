//! What is particular to the Uno's firmware for text: how it shares its time between four axes, statuses and answers.

use super::winch::script;
use pulsetrain_testkit::winch::{Uno, follow};

#[test]
fn statuses_are_on_time_while_four_axes_run() {
    for (speed, most_us) in [(4000, 1300), (9000, 1500), (10_000, 1500)] {
        let mut uno = Uno::new();
        uno.send("l xyza 10000 100000\ng xyza 2 1\nsrate 40\n");
        uno.send(format!("v xyza {} {} {} {}\n", speed, speed - 31, -speed, 17 - speed));
        uno.run_ms(800);
        let had = uno.statuses().len();
        uno.run_ms(2000);
        let statuses = &uno.statuses()[had..];
        assert!(statuses.len() >= 48, "{}", statuses.len());
        let late: Vec<i32> = statuses
            .iter()
            .enumerate()
            .map(|(at, status)| status.usec - statuses[0].usec - 40_000 * at as i32)
            .collect();
        let apart = late.iter().max().unwrap() - late.iter().min().unwrap();
        println!("at {speed} steps/s statuses are within {apart} us of one time in 40 ms");
        assert!(apart <= most_us, "{speed} steps/s: {apart} us");
        uno.check_positions();
    }
}

#[test]
fn four_axes_at_full_speed() {
    let mut uno = Uno::new();
    let mut said = script(&mut uno, &[(5, "l xyza 10000 100000"), (5, "g xyza 2 1")]);
    said.extend(script(&mut uno, &[(5, "v xyza 9999 -9935 9971 -9935")]));
    uno.run_ms(1200);
    let (late, longest) = follow(&uno, &said).unwrap();
    // Once at speed: more than 38 steps a millisecond.
    let mut late: Vec<i64> = late.iter().flat_map(|late| &late[late.len() - 9000..]).copied().collect();
    late.sort_unstable();
    let (least, most, p99) = (late[0], late[late.len() - 1], late[late.len() * 99 / 100]);
    println!("{} steps: {least} to {most} ticks late, 99 % at most {p99}; {} us", late.len(), longest / 16);
    assert!(least >= -38 && p99 <= 64 && most <= 100, "{least} {p99} {most}");
    // And meanwhile the line is full of lines, both ways.

    uno.send("d y 10\n".repeat(100));
    uno.send("a x 7000000000\n".repeat(20));
    uno.run_ms(200);
    uno.send("v xyza 0 0 0 0\nsrate 200\n");
    uno.run_ms(1800);
    uno.check_positions();
    let [_, y, _, a] = uno.statuses().last().unwrap().positions;
    assert_eq!(y - a, 1000, "of two that drift alike, one has moved by so much");
    assert!(uno.lines.iter().any(|line| line.text == "err range 3"));
    assert!(uno.lines.iter().skip(1).all(|line| line.text != "awake"));
}

#[test]
fn a_refusal_among_many_answers_is_told() {
    for (before, after) in [(0, 200), (10, 40), (40, 10), (100, 0), (100, 1), (100, 100)] {
        let mut uno = Uno::new();
        uno.send(format!("{}a x nan\n{}", "version\n".repeat(before), "version\n".repeat(after)));
        uno.run_ms(1500);
        let refusals = uno.lines.iter().filter(|line| line.text == "err number 3").count();
        assert_eq!(refusals, 1, "{before} lines before it, {after} after: {:?}", uno.lines);
    }
}

/// So often that a line takes longer, and back: no more than there is time for, and none is made up for.
#[test]
fn statuses_come_as_often_as_the_line_takes_them() {
    let mut uno = Uno::new();
    uno.send("srate 1\n");
    uno.run_ms(500);
    let had = uno.statuses().len();
    assert!(had > 100, "{had}");
    uno.send("srate 200\n");
    // Until those have come that were said before.
    uno.run_ms(10);
    let had = uno.statuses().len();
    uno.run_ms(1000);
    assert!((4..=6).contains(&(uno.statuses().len() - had)), "{:?}", &uno.statuses()[had..]);
    // Each at the first look behind its time, which is 200 ms after that of the one before: nothing adds up.
    let slow = &uno.statuses()[had + 1..];
    for (at, status) in slow.iter().enumerate() {
        let late = status.usec - slow[0].usec - 200_000 * at as i32;
        assert!((-1100..1100).contains(&late), "{late} us");
    }
}
