//! The gate: the checks that must pass before a change lands.

use crate::command::{self, Done, Failure, cargo, command, root};
use crate::usage::{self, Calibration};
use crate::{accept, boards, cross_check, firmware, installs, page, test};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use std::{env, fs, thread};

/// Number of random motions that the gate plans and runs, and their seed. `cargo xtask soak` tries thousands.
const ACCEPT_COUNT: u64 = 120;
const ACCEPT_SEED: u64 = 7;

/// A stage of the gate.
struct Stage {
    name: &'static str,
    /// Processor time that it may take, s, on the machine of [`usage::REFERENCE`], from a clean clone with a filled cargo cache.
    budget_s: u32,
    run: fn() -> Done,
}

const fn stage(name: &'static str, budget_s: u32, run: fn() -> Done) -> Stage {
    Stage { name, budget_s, run }
}

/// The stages, in the order in which they run. Those of one group run side by side. The cheapest stage comes first, so
/// that a failure comes early.
const GROUPS: [&[Stage]; 6] = [
    &[stage("format", 10, format)],
    // One downloads, the other computes.
    &[stage("installs", 60, installs::all), stage("documentation", 120, documentation)],
    // The committed images, which virtual boards run in the tests too, must be those of the sources.
    &[stage("lints", 240, lints), stage("images", 60, images)],
    &[stage("wasm32", 60, boards::check_wasm), stage("packages", 10, packages)],
    &[stage("tests", 1500, || test::run(test::Tier::Change))],
    // The browser waits more than it computes.
    &[
        stage("page", 60, || page::test(false)),
        stage("cross-check", 155, cross_check::run),
        stage("accepted motions run", 180, || accept::run(&accept::Options::random(ACCEPT_COUNT, ACCEPT_SEED))),
    ],
];

/// Wall time that all stages may take together on two cores of that machine. Printed, never asserted: cores are shared.
const WALL: Duration = Duration::from_secs(15 * 60);

/// What a stage took.
struct Taken {
    name: &'static str,
    budget_s: u32,
    wall: Duration,
    /// `None` where the system does not say.
    processor_s: Option<f64>,
    /// How many times as long as on the reference machine the calibration loop took meanwhile.
    scale: f64,
}

/// Runs every stage, and prints what each took beside its budget; or runs one stage alone.
pub(crate) fn run(only: Option<&str>) -> Done {
    if let Some(name) = only {
        let stage = GROUPS.iter().copied().flatten().find(|stage| stage.name == name);
        let names = || GROUPS.iter().copied().flatten().map(|stage| stage.name).collect::<Vec<_>>().join(", ");
        let stage = stage.ok_or_else(|| Failure::Check(format!("no stage {name:?}; there are: {}", names())))?;
        return (stage.run)();
    }
    let begin = Instant::now();
    let calibration = Calibration::start();
    // It is asked for now: the build of the tests replaces the file, and then this process has none.
    let this = env::current_exe().map_err(|why| Failure::Start { command: "xtask".to_owned(), why })?;
    let mut all = Vec::new();
    let mut result = Ok(());
    for group in GROUPS {
        let alone = group.len() == 1;
        let done = thread::scope(|scope| {
            let running: Vec<_> =
                group.iter().map(|stage| scope.spawn(|| in_a_process(&this, stage, alone, &calibration))).collect();
            running.into_iter().map(|thread| thread.join().unwrap_or_else(|_| Err(broken()))).collect()
        });
        match command::all(done) {
            Ok(taken) => all.extend(taken),
            Err(failure) => {
                result = Err(failure);
                break;
            }
        }
    }
    print!("{}", table(&all, begin.elapsed()));
    result.and_then(|()| within_budgets(&all))?;
    println!("xtask ci: all passed");
    Ok(())
}

fn broken() -> Failure {
    Failure::Check("a stage of xtask ci panicked".to_owned())
}

/// Runs a stage as a process of its own, whose processor time is its own. Its output comes as it is made if it runs `alone`,
/// else in one piece.
fn in_a_process(this: &Path, stage: &'static Stage, alone: bool, calibration: &Calibration) -> Done<Taken> {
    let file = usage::file(stage.name)?;
    let (begin, mark) = (Instant::now(), calibration.mark());
    let mut process = command(this);
    process.args(["ci", "--stage", stage.name]).env(usage::FILE, &file);
    if alone {
        command::run(&mut process)?
    } else {
        command::run_apart(&mut process, stage.name).map(drop)?
    }
    let Stage { name, budget_s, .. } = *stage;
    let scale = calibration.since(mark);
    Ok(Taken { name, budget_s, wall: begin.elapsed(), processor_s: usage::written(&file), scale })
}

/// The times of the stages, a row each.
fn table(all: &[Taken], wall: Duration) -> String {
    let minutes = |seconds: f64| format!("{}:{:02}", seconds as u64 / 60, seconds as u64 % 60);
    let mut text = format!(
        "\nxtask ci, min:s\n{:<22} {:>6} {:>10} {:>7} {:>6}\n",
        "stage", "wall", "processor", "budget", "scale"
    );
    for taken in all {
        let processor = taken.processor_s.map_or("–".to_owned(), minutes);
        let (budget, note) = (minutes(taken.budget_s.into()), taken.note());
        let wall = minutes(taken.wall.as_secs_f64());
        text.push_str(&format!(
            "{:<22} {wall:>6} {processor:>10} {budget:>7} {:>6.2}{note}\n",
            taken.name, taken.scale
        ));
    }
    let processor: f64 = all.iter().filter_map(|taken| taken.processor_s).sum();
    let budget: u32 = all.iter().map(|taken| taken.budget_s).sum();
    let (wall_s, most) = (minutes(wall.as_secs_f64()), minutes(WALL.as_secs_f64()));
    text.push_str(&format!("{:<22} {wall_s:>6} {:>10} {:>7}\n", "all", minutes(processor), minutes(budget.into())));
    text.push_str(&format!(
        "wall time wanted: {most} on two free cores; scale: the calibration loop beside the stages, 1.00 on such\n"
    ));
    text
}

impl Taken {
    /// Processor time as it would be on the reference machine, in budgets.
    fn share(&self) -> Option<f64> {
        // A quicker machine gets no smaller budget.
        self.processor_s.map(|seconds| seconds / self.scale.max(1.0) / f64::from(self.budget_s))
    }

    fn note(&self) -> &'static str {
        match self.share() {
            Some(share) if share > MAX_BUDGETS => "  more than twice its budget",
            Some(share) if share > 1.0 => "  above its budget",
            _ => "",
        }
    }
}

/// The gate fails if a stage takes more than this many budgets.
const MAX_BUDGETS: f64 = 2.0;

fn within_budgets(all: &[Taken]) -> Done {
    let over: Vec<_> = all.iter().filter(|taken| taken.share().is_some_and(|share| share > MAX_BUDGETS)).collect();
    if over.is_empty() {
        return Ok(());
    }
    let names: Vec<_> = over.iter().map(|taken| taken.name).collect();
    Err(Failure::Check(format!(
        "more than twice the budget of processor time: {}. Make the stage quicker, move tests to soak (docs/testing.md), or raise its \
         budget in xtask/src/ci.rs and say why",
        names.join(", ")
    )))
}

fn format() -> Done {
    command::run(command("rustup").args(["component", "add", "rustfmt", "clippy"]))?;
    command::run(&mut cargo("fmt --all --check"))?;
    for manifest in ["fuzz/Cargo.toml", "xtask/cross-check/usb_serial/Cargo.toml"] {
        command::run(&mut cargo(&format!("fmt --manifest-path {manifest} --check")))?;
    }
    Ok(())
}

/// The feature `midi` stands on ALSA, a library of the system.
fn lints() -> Done {
    installs::alsa()?;
    command::run(&mut cargo("clippy --workspace --all-targets -- -D warnings"))?;
    command::run(&mut cargo("clippy --package pulsetrain --features midi -- -D warnings"))
}

fn images() -> Done {
    firmware::check_uno().and_then(|()| firmware::pico::check())
}

/// Crates that are published, by folder.
fn published() -> Done<Vec<String>> {
    let folders =
        fs::read_dir(root().join("crates")).map_err(|why| Failure::File { path: root().join("crates"), why })?;
    let mut names = Vec::new();
    for folder in folders.flatten() {
        let manifest = folder.path().join("Cargo.toml");
        let text = fs::read_to_string(&manifest).map_err(|why| Failure::File { path: manifest, why })?;
        if !text.contains("publish = false") {
            names.push(folder.file_name().to_string_lossy().into_owned());
        }
    }
    names.sort();
    Ok(names)
}

/// Checks what each package would contain: all files that its sources include, and nothing from outside its folder.
/// `cargo xtask soak` builds the packages.
fn packages() -> Done {
    for name in published()? {
        let folder = root().join("crates").join(&name);
        let list = command::output(
            cargo("package --quiet --list --allow-dirty --manifest-path").arg(folder.join("Cargo.toml")),
        )?;
        let files: Vec<&str> = list.lines().collect();
        for file in files.iter().filter(|file| file.starts_with("src/") && file.ends_with(".rs")) {
            let path = folder.join(file);
            let text = fs::read_to_string(&path).map_err(|why| Failure::File { path: path.clone(), why })?;
            for included in included(&text) {
                let there = within(&folder, &path, &included);
                if there.is_none_or(|there| !files.contains(&there.as_str())) {
                    return Err(Failure::Check(format!("{}: the package would lack {included}", path.display())));
                }
            }
        }
    }
    Ok(())
}

/// The paths in `include_str!("…")` and `include_bytes!("…")`, but for those of the tests at a file's end.
fn included(source: &str) -> Vec<String> {
    let source = source.split("\n#[cfg(test)]\nmod ").next().unwrap_or(source);
    let after = |macro_name: &'static str| source.split(macro_name).skip(1);
    let all = after("include_str!(\"").chain(after("include_bytes!(\""));
    all.filter_map(|rest| rest.split_once('"').map(|(path, _)| path.to_owned())).collect()
}

/// `included`, a path from the folder of `source`, as a path from `folder`. `None` if it is outside.
fn within(folder: &Path, source: &Path, included: &str) -> Option<String> {
    let mut parts: Vec<&str> = Vec::new();
    let from = source.parent()?.strip_prefix(folder).ok()?.to_str()?;
    for part in from.split('/').chain(included.split('/')).filter(|part| !part.is_empty()) {
        if part == ".." {
            parts.pop()?;
        } else {
            parts.push(part);
        }
    }
    Some(parts.join("/"))
}

/// Builds each package from its own files: what a program that embeds the crates gets.
pub(crate) fn build_packages() -> Done {
    forget_unpacked()?;
    let mut package = cargo("package --workspace --quiet --allow-dirty");
    let names = published()?;
    let ours = names.iter().map(|name| if name == "pulsetrain" { name.clone() } else { format!("pulsetrain-{name}") });
    command::run(package.args(ours.flat_map(|name| ["--package".to_owned(), name])))
}

/// Removes the sources that cargo unpacked from earlier packages of ours. It takes them for those of a package of the same version.
fn forget_unpacked() -> Done {
    let home = env::var_os("CARGO_HOME").map(PathBuf::from).or_else(|| Some(env::home_dir()?.join(".cargo")));
    let Some(Ok(registries)) = home.map(|home| fs::read_dir(home.join("registry/src"))) else { return Ok(()) };
    // A registry in a folder, as `cargo package` makes one, has a name without a host.
    let local = registries.flatten().filter(|registry| registry.file_name().to_string_lossy().starts_with('-'));
    for package in local.filter_map(|registry| fs::read_dir(registry.path()).ok()).flatten().flatten() {
        if package.file_name().to_string_lossy().starts_with("pulsetrain-") {
            let path = package.path();
            fs::remove_dir_all(&path).map_err(|why| Failure::File { path, why })?;
        }
    }
    Ok(())
}

fn documentation() -> Done {
    command::run(cargo("doc --workspace --no-deps --document-private-items").env("RUSTDOCFLAGS", "-D warnings"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn taken(processor_s: f64, scale: f64) -> Taken {
        let wall = Duration::from_secs(61);
        Taken { name: "lints", budget_s: 100, wall, processor_s: Some(processor_s), scale }
    }

    #[test]
    fn a_budget_is_scaled_by_the_calibration_loop() {
        assert!(within_budgets(&[taken(199.0, 1.0)]).is_ok());
        let said = within_budgets(&[taken(201.0, 1.0)]).expect_err("more than twice").to_string();
        assert!(said.contains("lints") && said.contains("budget"), "{said}");
        assert!(within_budgets(&[taken(299.0, 1.5)]).is_ok());
        assert!(within_budgets(&[taken(301.0, 1.5)]).is_err());
        // A quicker machine gets no smaller budget.
        assert!(within_budgets(&[taken(199.0, 0.5)]).is_ok());
    }

    #[test]
    fn the_table_warns() {
        let all = [taken(99.0, 1.0), taken(101.0, 1.0), taken(250.0, 1.0)];
        let text = table(&all, Duration::from_secs(125));
        let rows: Vec<_> = text.lines().filter(|line| line.starts_with("lints")).collect();
        assert!(rows[0].ends_with("1.00") && rows[0].contains("1:01"), "{text}");
        assert!(rows[1].ends_with("above its budget") && rows[2].ends_with("more than twice its budget"), "{text}");
        assert!(text.contains("all                      2:05       7:30    5:00"), "{text}");
    }

    #[test]
    fn what_a_package_lacks_is_found() {
        let source =
            r#"const A: &str = include_str!("tables/a.csv"); static B: &[u8] = include_bytes!("../../out.bin");"#;
        assert_eq!(included(source), ["tables/a.csv", "../../out.bin"]);
        let in_tests = "use a::b;\n\n#[cfg(test)]\nmod tests {\n    include_str!(\"../../examples/live.toml\")\n}\n";
        assert!(included(in_tests).is_empty());
        let (folder, file) = (Path::new("/r/crates/plot"), Path::new("/r/crates/plot/src/draw.rs"));
        assert_eq!(within(folder, file, "tables/a.csv").as_deref(), Some("src/tables/a.csv"));
        assert_eq!(within(folder, file, "../font.ttf").as_deref(), Some("font.ttf"));
        assert_eq!(within(folder, file, "../../out.bin"), None);
    }

    #[test]
    fn stages_have_names_of_their_own() {
        let mut names: Vec<_> = GROUPS.iter().copied().flatten().map(|stage| stage.name).collect();
        let count = names.len();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), count);
    }
}
