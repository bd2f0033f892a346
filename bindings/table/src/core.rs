//! Code of all bindings: commands, conversions, kinds of events and requests.

use crate::table::{
    Call, CallField, EVENTS, FieldKind, Owner, REQUESTS, RecordMember, Reported, Table,
    ValueRecord, camel, comment, fill, pascal, snake,
};

/// The command of a call, whose body is `id` and whose fields have these values.
#[must_use]
pub fn made(call: &Call, value: &dyn Fn(&CallField) -> String) -> String {
    let Some(alternative) = &call.alternative else {
        let mut fields: Vec<_> = call
            .fields
            .iter()
            .map(|field| assigned(&field.snake(), value(field)))
            .collect();
        if call.of == Owner::Body {
            fields.insert(0, "id".to_owned());
        }
        return format!("Command::{} {{ {} }}", call.command, fields.join(", "));
    };
    let of = match call.fields.first() {
        None => format!("Locomotion::{}", pascal(alternative)),
        Some(field) if matches!(field.kind, FieldKind::Record(_)) => {
            format!("{}.into()", value(field))
        }
        Some(field) => {
            let inner = assigned(&field.snake(), value(field));
            format!("{} {{ {inner} }}.into()", pascal(alternative))
        }
    };
    format!(
        "Command::{} {{ id, locomotion: Box::new({of}) }}",
        call.command
    )
}

fn assigned(name: &str, value: String) -> String {
    match name == value {
        true => value,
        false => format!("{name}: {value}"),
    }
}

/// The call that takes a record.
///
/// # Panics
///
/// When there is none.
#[must_use]
pub fn plain<'a>(table: &'a Table, record: &ValueRecord) -> &'a Call {
    let takes = |field: &CallField| match &field.kind {
        FieldKind::Record(of) | FieldKind::List { of, .. } => *of == record.name,
        _ => false,
    };
    let mut calls = table.calls.iter();
    calls
        .find(|call| call.fields.iter().any(takes))
        .expect("a call that takes the record")
}

const HEAD: &str = "\
//! Commands in other coordinates, and the kinds of events and requests.
//!
//! Made by `bindings/table` from `spec/tables/protocol.json`; do not edit.

use rhumb_client::scene::{
    ActiveEvents, Character, CharacterStep, Command, Locomotion, Vehicle, Wheel, WheelInput,
};

use crate::coordinates::Coordinates;

impl Coordinates {
    /// A command in Rhumb's coordinates.
    ///
    /// Descriptions of bodies and shapes pass as they are: no binding offers such commands.
    #[must_use]
    pub fn command_in(self, mut command: Command) -> Command {
        match &mut command {
@arms@\
            Command::AddJoint { joint, .. } | Command::ChangeJoint { joint, .. } => {
                **joint = self.joint_in(joint);
            }
@locomotions@\
            // The others have no axes and no lengths.
            _ => {}
        }
        command
    }
@records@\
}

@events@
@requests@";

/// `bindings/core/src/generated.rs`.
#[must_use]
pub fn generated(table: &Table) -> String {
    let converted =
        |call: &&Call| call.alternative.is_none() && call.fields.iter().any(is_converted);
    let arms: String = table.calls.iter().filter(converted).map(arm).collect();
    let records: String = table.records.iter().map(record).collect();
    let each: Vec<_> = EVENTS
        .iter()
        .map(|event| format!("Self::{}", pascal(event.name)))
        .collect();
    let each = format!(
        "/// Each of them, in the order of their numbers in C.\npub const EACH: [Self; {}] = [{}];\n\n",
        EVENTS.len(),
        each.join(", ")
    );
    fill(
        HEAD,
        &[
            ("arms", &arms),
            ("locomotions", LOCOMOTIONS),
            ("records", &records),
            ("events", &kinds(("an event", "EventKind"), &EVENTS, &each)),
            (
                "requests",
                &kinds(("a request", "RequestKind"), &REQUESTS, ""),
            ),
        ],
    )
}

const KINDS: &str = "\
/// The kind of @what@.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum @name@ {
@kinds@
}

impl @name@ {
@each@
    /// Its name in languages without enumerations.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
@words@\
        }
    }
}
";

/// An enumeration of kinds, each with its word.
fn kinds((what, name): (&str, &str), of: &[Reported], each: &str) -> String {
    let kinds = of
        .iter()
        .map(|one| comment("///", one.doc) + &pascal(one.name) + ",\n");
    let word = |name: &str| format!("Self::{} => {name:?},\n", pascal(name));
    let words: String = of.iter().map(|one| word(one.name)).collect();
    fill(
        KINDS,
        &[
            ("what", what),
            ("name", name),
            ("kinds", &kinds.collect::<String>()),
            ("each", each),
            ("words", &words),
        ],
    )
}

/// The alternatives of the one command that has some.
const LOCOMOTIONS: &str = "\
            Command::SetLocomotion { locomotion, .. } => match &mut **locomotion {
                Locomotion::None => {}
                Locomotion::Character(character) => *character = self.character_in(*character),
                Locomotion::Vehicle(Vehicle { wheels }) => {
                    for wheel in wheels {
                        *wheel = self.wheel_in(*wheel);
                    }
                }
            },
";

/// True if a field has axes or a unit of length.
fn is_converted(field: &CallField) -> bool {
    conversion(field).is_some()
}

/// The conversion of a field.
fn conversion(field: &CallField) -> Option<String> {
    let unit = field.unit.as_deref().unwrap_or_default();
    let name = match (&field.kind, unit) {
        (FieldKind::Vector, "") => "direction_in",
        (FieldKind::Vector, "rad/s") => "angular_in",
        (FieldKind::Vector, "N m" | "N m s") => "torque_in",
        (FieldKind::Vector, _) => "vector_in",
        (FieldKind::Rotation, _) => "rotation_in",
        (FieldKind::Number, "m" | "m/s" | "m/s2" | "N" | "N s") => "length_in",
        (FieldKind::Number, _) if field.is_turn => "turn_in",
        (FieldKind::Record(of) | FieldKind::List { of, .. }, _) => return Some(snake(of) + "_in"),
        _ => return None,
    };
    Some(name.to_owned())
}

fn arm(call: &Call) -> String {
    let converted: Vec<_> = call
        .fields
        .iter()
        .filter(|field| is_converted(field))
        .collect();
    let names: Vec<_> = converted.iter().map(|field| field.snake()).collect();
    let statement = |field: &&CallField| {
        let (name, convert) = (field.snake(), conversion(field).unwrap_or_default());
        match &field.kind {
            FieldKind::List { .. } => {
                let one = name.trim_end_matches('s');
                format!("for {one} in {name} {{ *{one} = self.{convert}(*{one}); }}\n")
            }
            _ => format!("*{name} = self.{convert}(*{name});\n"),
        }
    };
    let statements: String = converted.iter().map(statement).collect();
    let (command, names) = (&call.command, names.join(", "));
    format!("Command::{command} {{ {names}, .. }} => {{\n{statements}}}\n")
}

/// The conversion of a record.
fn record(record: &ValueRecord) -> String {
    let (own, name) = (snake(&record.name), pascal(&record.name));
    let of = |field: &CallField, path: &str, place: &str| {
        let convert = conversion(field);
        convert.map(|convert| format!("{place}: self.{convert}({path}{place}),\n"))
    };
    let mut untouched = false;
    let mut parts = String::new();
    for member in &record.members {
        let converted = match member {
            RecordMember::Plain(field) => of(field, &format!("{own}."), &field.snake()),
            RecordMember::Optional(field) => conversion(field).map(|convert| {
                let field = field.snake();
                format!("{field}: {own}.{field}.map(|{field}| self.{convert}({field})),\n")
            }),
            RecordMember::Group(group, fields) => {
                let each = fields
                    .iter()
                    .map(|field| of(field, &format!("{group}."), &field.within(group)));
                let (each, rest): (Vec<_>, Vec<_>) = each.partition(Option::is_some);
                let each: String = each.into_iter().flatten().collect();
                let rest = if rest.is_empty() {
                    String::new()
                } else {
                    format!("..{group}")
                };
                let kind = format!("{name}{}", pascal(group));
                Some(format!(
                    "{group}: {own}.{group}.map(|{group}| {kind} {{ {each} {rest} }}),\n"
                ))
            }
        };
        untouched |= converted.is_none();
        parts += &converted.unwrap_or_default();
    }
    let rest = if untouched {
        format!("..{own}")
    } else {
        String::new()
    };
    let doc = format!("The {} in Rhumb's coordinates.", camel_words(&record.name));
    format!(
        "\n{}    #[must_use]\n    pub fn {own}_in(self, {own}: {name}) -> {name} {{\n {name} {{\n{parts}{rest} }}\n }}\n",
        comment("    ///", &doc)
    )
}

fn camel_words(name: &str) -> String {
    match camel(name).as_str() {
        "wheelInput" => "input of a wheel".to_owned(),
        "activeEvents" => "events that a body reports".to_owned(),
        _ => name.to_owned(),
    }
}
