//! JSON Schemas of all JSON that the program prints: `docs/schema` has them as files, docs/json.md describes their use.

use schemars::{JsonSchema, SchemaGenerator, generate::SchemaSettings};
use serde_json::{Map, Value, json};

use crate::commands::{
    bake, bench, boards, calibrate, drivers, explain, flash, formula, info, motor, on_port, ports, stop, store, verify,
};
use crate::winch::run::WinchReport;
use pulsetrain_report::error::ErrorReport;
use pulsetrain_report::plan_report::PlanReport;
use pulsetrain_report::run_report::{RunReport, StoppedReport};
use pulsetrain_session::control::Event;
use pulsetrain_trace::verdict::FilmReport;

/// The schemas, by command. `run` also describes report.json; `error` is what any command prints with `--json` if it is refused.
///
/// ```
/// let schemas = pulsetrain::schema::all();
/// assert!(schemas.iter().any(|(name, schema)| *name == "run" && schema["anyOf"].is_array()));
/// ```
#[must_use]
pub fn all() -> Vec<(&'static str, Value)> {
    vec![
        (
            "run",
            any_of("What `pulsetrain run --json` prints, and report.json", |schemas| {
                schemas.add::<RunReport>();
                schemas.add::<on_port::PortReport>();
                schemas.add::<StoppedReport>();
            }),
        ),
        ("plan", one::<PlanReport>("What `pulsetrain plan --json` prints")),
        (
            "verify",
            any_of("What `pulsetrain verify --json` prints: of edges and steps, or of a film", |schemas| {
                schemas.add::<verify::VerifyReport>();
                schemas.add::<FilmReport>();
            }),
        ),
        (
            "explain",
            any_of("What `pulsetrain explain --json` prints: of a motion, or of machines' paths", |schemas| {
                schemas.add::<explain::Explanation>();
                schemas.add::<explain::PathExplanations<'static>>();
            }),
        ),
        ("motor", one::<Vec<motor::WindingReport>>("What `pulsetrain motor --json` prints")),
        ("boards", one::<Vec<boards::BoardTableRow>>("What `pulsetrain boards --json` prints")),
        ("drivers", one::<Vec<drivers::DriverTableRow>>("What `pulsetrain drivers --json` prints")),
        ("info", one::<info::BoardInfo>("What `pulsetrain info --json` prints")),
        (
            "stop",
            any_of("What `pulsetrain stop --json` prints: of runs of this computer, or of a board", |schemas| {
                schemas.add::<Vec<stop::StoppedRunReport>>();
                schemas.add::<stop::StopReport>();
            }),
        ),
        ("formula", one::<formula::TriedFormula>("What `pulsetrain formula --json` prints")),
        ("event", one::<Event>("What `pulsetrain pause`, `resume` and `tempo --json` print: an event of the run")),
        ("store", one::<store::StoreReport>("What `pulsetrain store --json` prints")),
        ("bench", one::<bench::Rows>("What `pulsetrain bench --json` prints")),
        ("winch", one::<WinchReport>("What `pulsetrain winch SCRIPT --json` prints, and its report.json")),
        ("flash", one::<flash::Flashed>("What `pulsetrain flash --json` prints")),
        ("ports", one::<Vec<ports::PortEntry>>("What `pulsetrain ports --json` prints")),
        ("calibrate", one::<calibrate::ClockReport>("What `pulsetrain calibrate --json` prints")),
        (
            "bake",
            any_of("What `pulsetrain bake --json` prints: of an image, or of a sketch", |schemas| {
                schemas.add::<bake::BakedImage>();
                schemas.add::<bake::BakedSketch>();
            }),
        ),
        ("error", one::<ErrorReport>("What a command prints with `--json` if it is refused (exit code 2)")),
    ]
}

/// Types of which an output is one.
struct Schemas {
    generator: SchemaGenerator,
    found: Vec<Value>,
}

impl Schemas {
    fn new() -> Schemas {
        // Keys that are left out where they have no value are not required: the contract is that of what is printed.
        let generator = SchemaSettings::draft2020_12().for_serialize().into_generator();
        Schemas { generator, found: Vec::new() }
    }

    fn add<T: JsonSchema>(&mut self) {
        let schema = self.generator.subschema_for::<T>();
        self.found.push(schema.to_value());
    }

    fn finish(mut self, about: &str, content: impl FnOnce(Vec<Value>) -> Map<String, Value>) -> Value {
        let mut root = Map::new();
        root.insert("$schema".to_owned(), json!("https://json-schema.org/draft/2020-12/schema"));
        root.insert("description".to_owned(), json!(about));
        root.extend(content(self.found));
        root.insert("$defs".to_owned(), Value::Object(self.generator.take_definitions(true)));
        let mut root = Value::Object(root);
        close(&mut root, true);
        root
    }
}

fn any_of(about: &str, add: impl FnOnce(&mut Schemas)) -> Value {
    let mut schemas = Schemas::new();
    add(&mut schemas);
    schemas.finish(about, |found| Map::from_iter([("anyOf".to_owned(), Value::Array(found))]))
}

fn one<T: JsonSchema>(about: &str) -> Value {
    let mut schemas = Schemas::new();
    schemas.add::<T>();
    schemas.finish(about, |found| match found.into_iter().next() {
        Some(Value::Object(schema)) => schema,
        _ => Map::new(),
    })
}

/// Lets objects have no other keys than those that are described, so that a check finds what a document leaves out.
fn close(schema: &mut Value, is_whole: bool) {
    match schema {
        Value::Array(all) => all.iter_mut().for_each(|schema| close(schema, is_whole)),
        Value::Object(object) => {
            let branches = ["oneOf", "anyOf", "allOf"];
            let is_object = object.get("properties").is_some_and(Value::is_object) && object.contains_key("type");
            let has_branches = branches.iter().any(|branch| object.contains_key(*branch));
            for (key, value) in object.iter_mut() {
                match key.as_str() {
                    // Branches of an object describe more keys of the same object.
                    key if branches.contains(&key) => close(value, !is_object),
                    "properties" | "$defs" => {
                        value.as_object_mut().into_iter().flatten().for_each(|(_, schema)| close(schema, true));
                    }
                    "items" | "prefixItems" | "additionalProperties" => close(value, true),
                    _ => {}
                }
            }
            if is_object && is_whole {
                let key = if has_branches { "unevaluatedProperties" } else { "additionalProperties" };
                object.entry(key).or_insert(Value::Bool(false));
            }
        }
        _ => {}
    }
}
