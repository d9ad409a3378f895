//! The outcome of a motion, by the program's exit codes and output.

use serde_json::Value;

/// How a process ended.
#[derive(Debug, Default)]
pub(crate) struct Ended {
    /// The exit code. `None` if a signal ended it.
    pub(crate) code: Option<i32>,
    pub(crate) stdout: Vec<u8>,
    pub(crate) stderr: Vec<u8>,
    /// It did not come to an end, and was ended.
    pub(crate) hung: bool,
}

/// The outcome of a motion. All but [`Outcome::Passed`] have the program's message.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Outcome {
    /// `plan` refused it.
    Refused(String),
    /// It ran, and the result is as planned.
    Passed,
    /// Anything else is a fault, also that the motors stopped on the way: an accepted motion must run.
    Broken(String),
}

/// The JSON of `plan` and `run`: a report with exit codes 0, 1 and 3, a refusal with exit code 2.
enum Printed {
    Report(Value),
    Refusal(String),
}

/// Reads the output of `pulsetrain plan FILE --json`: the report, or the outcome if there is none.
pub(crate) fn planned(ended: &Ended) -> Result<Value, Outcome> {
    match (ended.code, said(ended)?) {
        (Some(0), Printed::Report(report)) if report["motors"].is_array() => Ok(report),
        (Some(2), Printed::Refusal(message)) if is_ours(&message) => Err(Outcome::Broken(format!("plan: {message}"))),
        (Some(2), Printed::Refusal(message)) => Err(Outcome::Refused(message)),
        (code, _) => Err(Outcome::Broken(format!("plan: exit code {code:?} with another report"))),
    }
}

/// Reads the output of `pulsetrain run FILE --json`; `plan` is the report of the command `plan`.
pub(crate) fn ran(plan: &Value, ended: &Ended) -> Outcome {
    let report = match said(ended) {
        Err(outcome) => return outcome,
        Ok(Printed::Refusal(message)) => {
            return Outcome::Broken(match ended.code {
                Some(2) => format!("run: {message}"),
                code => format!("run, exit code {code:?}: {message}"),
            });
        }
        Ok(Printed::Report(report)) => report,
    };
    let (verdict, lateness) = (&report["verdict"], &report["lateness"]);
    let (lost, extra) = (&lateness["lost"], &lateness["extra"]);
    let verdict_ok = verdict["ok"] == true;
    let is_whole = verdict_ok && *lost == 0 && *extra == 0;
    match ended.code {
        Some(0) if !is_whole => {
            Outcome::Broken(format!("exit code 0: verdict {}, lost {lost}, added {extra}", verdict["ok"]))
        }
        // The run must have the plan's steps, and the pins must show them.
        Some(0) if report["motors"] != plan["motors"] => Outcome::Broken("run's plan is not plan's".to_owned()),
        Some(0) => match wrong_end(&report) {
            Some(wrong) => Outcome::Broken(wrong),
            None => Outcome::Passed,
        },
        Some(1) if verdict_ok => {
            Outcome::Broken(format!("exit code 1 with a verdict of PASS: steps lost {lost}, added {extra}"))
        }
        Some(1) => Outcome::Broken(format!("run: {}", failure(verdict))),
        Some(3) => Outcome::Broken(match report["stopped"]["message"].as_str() {
            Some(message) => format!("run, stopped: {message}"),
            None => "run: exit code 3, and it does not say what stopped it".to_owned(),
        }),
        code => Outcome::Broken(format!("run: exit code {code:?} with a report")),
    }
}

/// Reads the output of `pulsetrain verify` for the trace of a run that passed.
pub(crate) fn verified(ended: &Ended) -> Outcome {
    match said(ended) {
        Err(outcome) => outcome,
        Ok(Printed::Report(verdict)) if ended.code == Some(0) && verdict["ok"] == true => Outcome::Passed,
        Ok(Printed::Report(verdict)) => Outcome::Broken(format!("verify: {}", failure(&verdict))),
        Ok(Printed::Refusal(message)) => Outcome::Broken(format!("verify: {message}")),
    }
}

/// The first broken bound.
fn failure(verdict: &Value) -> String {
    let failure = &verdict["failures"][0];
    let text = |key: &str| failure[key].as_str().unwrap_or("?").to_owned();
    format!("{} of motor {} at {} s", text("fault"), text("motor"), failure["at_s"])
}

/// A motor whose pins end at another position than the plan.
fn wrong_end(report: &Value) -> Option<String> {
    let motors = report["motors"].as_array()?.iter().zip(report["verdict"]["motors"].as_array()?);
    let wrong = |plan: &Value, seen: &Value| plan["final_position_steps"] != seen["position_got_steps"];
    motors.into_iter().find(|(plan, seen)| wrong(plan, seen)).map(|(plan, seen)| {
        format!(
            "motor {} ends at {}, planned {}",
            plan["name"], seen["position_got_steps"], plan["final_position_steps"]
        )
    })
}

/// Whether the program says that the fault is its own.
fn is_ours(message: &str) -> bool {
    message.contains("please report")
}

fn said(ended: &Ended) -> Result<Printed, Outcome> {
    let broken = |why: String| Err(Outcome::Broken(why));
    if ended.hung {
        return broken("it does not end".to_owned());
    }
    let (Ok(stdout), Ok(stderr)) = (std::str::from_utf8(&ended.stdout), std::str::from_utf8(&ended.stderr)) else {
        return broken("what it says is no UTF-8".to_owned());
    };
    if let Some(at) = stderr.find("panicked at") {
        return broken(stderr[at..].lines().take(2).collect::<Vec<_>>().join(" "));
    }
    let Some(code) = ended.code else { return broken("it was ended by a signal".to_owned()) };
    let Ok(value) = serde_json::from_str::<Value>(stdout) else {
        return broken(format!("exit code {code}, and no JSON: {}", stdout.lines().next().unwrap_or_default()));
    };
    match value["message"].as_str() {
        None => Ok(Printed::Report(value)),
        // Such a file may be a mistake of the generator.
        Some(message) if value["filename"].is_string() => Ok(Printed::Refusal(format!("in the file: {message}"))),
        Some(message) => Ok(Printed::Refusal(message.to_owned())),
    }
}

/// The kind of a message: its first line, without numbers, motors' names, and the file's name at its beginning.
pub(crate) fn kind(message: &str) -> String {
    let line = message.lines().next().unwrap_or_default();
    let line = line.split_once(".toml: ").or_else(|| line.split_once(".toml:")).map_or(line, |(_, rest)| rest);
    let mut kind = String::new();
    let mut words = line.split(' ');
    while let Some(word) = words.next() {
        let word = blanked(word);
        // "1 000 000" is one number.
        match word.strip_prefix('#') {
            Some(rest) if kind.ends_with('#') => kind.push_str(rest),
            _ => {
                kind.push_str(if kind.is_empty() { "" } else { " " });
                kind.push_str(&word);
            }
        }
        if matches!(word.as_str(), "motor" | "arm") && words.next().is_some() {
            kind.push_str(" _");
        }
    }
    kind
}

/// A word with `#` in place of each number.
fn blanked(word: &str) -> String {
    let mut blanked = String::new();
    let is_part = |c: char| c.is_ascii_digit() || matches!(c, '.' | '-' | '\u{2212}');
    let mut rest = word;
    while let Some(at) = rest.find(|c: char| c.is_ascii_digit()) {
        let before = rest[..at].trim_end_matches(['-', '\u{2212}']);
        blanked.push_str(before);
        blanked.push('#');
        let number = rest[at..].trim_start_matches(is_part);
        // The full stop of a sentence is not part of its last number.
        blanked.push_str(if number.is_empty() && rest.ends_with('.') { "." } else { "" });
        rest = number;
    }
    blanked + rest
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLAN: &str = r#"{"board":"uno","motors":[{"name":"x","steps":8,"final_position_steps":4}]}"#;

    fn said(code: i32, stdout: &str) -> Ended {
        Ended { code: Some(code), stdout: stdout.into(), ..Ended::default() }
    }

    fn run(ok: bool, position_got: i64, lost: u64, extra: u64) -> String {
        let failures =
            if ok { "" } else { r#"{"motor":"x","step":41,"at_s":1.5,"fault":"off_time","error_ticks":119.5}"# };
        let motors = r#""motors":[{"name":"x","steps":8,"final_position_steps":4}]"#;
        let seen = format!(r#"[{{"motor":"x","position_got_steps":{position_got}}}]"#);
        format!(
            r#"{{"board":"uno",{motors},"verdict":{{"ok":{ok},"motors":{seen},"failures":[{failures}]}},"lateness":{{"lost":{lost},"extra":{extra}}}}}"#
        )
    }

    fn of_run(code: i32, stdout: &str) -> Outcome {
        ran(&planned(&said(0, PLAN)).expect("a plan"), &said(code, stdout))
    }

    fn broken(why: &str) -> Outcome {
        Outcome::Broken(why.to_owned())
    }

    /// The outputs as `--json` writes them.
    fn error(message: &str) -> String {
        format!(
            r#"{{"message": "{message}","severity": "error","causes": [],"help": "slower","labels": [],"related": []}}"#
        )
    }

    #[test]
    fn what_plan_refuses() {
        let message = "motion.toml: motor y: at t = 0.293945 s the law accelerates by 39347 steps/s²; the motor's limit is 23957 steps/s²";
        assert_eq!(planned(&said(2, &error(message))), Err(Outcome::Refused(message.to_owned())));
        let file = r#"{"message": "unknown law `sin`","severity": "error","causes": [],"filename": "motion.toml","labels": [],"related": []}"#;
        assert_eq!(planned(&said(2, file)), Err(Outcome::Refused("in the file: unknown law `sin`".to_owned())));
        assert!(matches!(planned(&said(1, PLAN)), Err(Outcome::Broken(_))));
        assert!(matches!(planned(&said(2, PLAN)), Err(Outcome::Broken(_))));
        assert!(matches!(planned(&said(0, &error("it is wrong"))), Err(Outcome::Broken(_))));
    }

    #[test]
    fn what_runs() {
        assert_eq!(of_run(0, &run(true, 4, 0, 0)), Outcome::Passed);
        let other = PLAN.replace("\"steps\":8", "\"steps\":9");
        let other = planned(&said(0, &other)).expect("a plan");
        assert_eq!(ran(&other, &said(0, &run(true, 4, 0, 0))), broken("run's plan is not plan's"));
        assert_eq!(of_run(0, &run(true, 5, 0, 0)), broken("motor \"x\" ends at 5, planned 4"));
    }

    #[test]
    fn pass_with_another_exit_code_or_steps_lost() {
        let expected = "exit code 1 with a verdict of PASS: steps lost 0, added 1175";
        assert_eq!(of_run(1, &run(true, 4, 0, 1175)), broken(expected));
        assert_eq!(of_run(0, &run(true, 4, 2, 0)), broken("exit code 0: verdict true, lost 2, added 0"));
        assert_eq!(of_run(1, &run(false, 4, 0, 0)), broken("run: off_time of motor x at 1.5 s"));
        assert!(matches!(of_run(0, &run(false, 4, 0, 0)), Outcome::Broken(_)));
    }

    #[test]
    fn what_stops_is_broken() {
        let message = "at 0.275 s the board's queue for motor a, which takes 94 bytes, was used up";
        let report = format!(r#"{{"motors": [], "stopped": {{"message": "{message}"}}}}"#);
        assert_eq!(of_run(3, &report), broken(&format!("run, stopped: {message}")));
        assert_eq!(of_run(2, &error(message)), broken(&format!("run: {message}")));
        assert_eq!(of_run(3, &error(message)), broken(&format!("run, exit code Some(3): {message}")));
    }

    #[test]
    fn processes_that_end_badly() {
        let panicked = Ended {
            code: Some(101),
            stderr: b"\nthread 'main' panicked at crates/plan/src/fit.rs:12:5:\nindex out of bounds\nnote: run with"
                .to_vec(),
            ..Ended::default()
        };
        assert_eq!(planned(&panicked), Err(broken("panicked at crates/plan/src/fit.rs:12:5: index out of bounds")));
        let hung = Ended { hung: true, ..Ended::default() };
        assert_eq!(ran(&Value::Null, &hung), broken("it does not end"));
        assert_eq!(ran(&Value::Null, &Ended::default()), broken("it was ended by a signal"));
        let bytes = Ended { code: Some(0), stdout: vec![b'"', 0xff, b'"'], ..Ended::default() };
        assert_eq!(verified(&bytes), broken("what it says is no UTF-8"));
        assert_eq!(of_run(0, "PASS"), broken("exit code 0, and no JSON: PASS"));
    }

    #[test]
    fn what_verify_says() {
        assert_eq!(verified(&said(0, r#"{"ok":true,"failures":[]}"#)), Outcome::Passed);
        let fails = r#"{"ok":false,"failures":[{"motor":"x","at_s":0.25,"fault":"missing"}]}"#;
        assert_eq!(verified(&said(1, fails)), broken("verify: missing of motor x at 0.25 s"));
        assert_eq!(verified(&said(2, &error("no such line"))), broken("verify: no such line"));
    }

    #[test]
    fn kinds_are_messages_without_numbers_and_names() {
        let check = |message, expected: &str| assert_eq!(kind(message), expected);
        check(
            "motion.toml: motor y: at t = 0.293945 s it runs at -3 steps/s²; the limit is 1 000 000.\nhelp",
            "motor _ at t = # s it runs at # steps/s²; the limit is #.",
        );
        check("in motion.toml:12:3: 5 ms", "#:#: # ms");
        check("panicked at crates/plan/src/fit.rs:12:5: index", "panicked at crates/plan/src/fit.rs:#:#: index");
        check("the A4988 has `p99`", "the A# has `p#`");
    }
}
