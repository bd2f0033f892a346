//! Commands, records and kinds of events and requests of C.
//!
//! The header and the imports of C# are read out of the file that it makes.

use crate::table::{
    Call, CallField, EVENTS, FieldKind, Lengths, Owner, REQUESTS, RecordMember, Reported, Table,
    ValueRecord, capital, comment, fill, meaning, pascal, snake,
};

const HEAD: &str = "\
//! Commands, records and kinds of events and requests of C.
//!
//! Made by `bindings/table` from `spec/tables/protocol.json`; do not edit.

use rhumb_bindings::rhumb_client::glam::{Quat, Vec3};
use rhumb_bindings::rhumb_client::scene::{
    ActiveEvents, Character, CharacterStep, Command, JumpFrom, Locomotion, Vehicle, Wheel, WheelInput,
};
use rhumb_bindings::{BindingError, EventKind, RequestKind, parse_packed_id};

use crate::border::{RhumbCode, elements, guard, one_of, value};
use crate::descriptions::RhumbBody;
use crate::scene::{RhumbScene, send};

@bits@
/// FieldKind of a command.
#[repr(u32)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RhumbCommandKind {
@kinds@
}

@choices@
/// A command, for `rhumb_scene_command`. Fields that its kind does not name are ignored. Units are kilograms, seconds,
/// radians, and the scene's unit of length.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RhumbCommand {
    /// A `RhumbCommandKind`.
    pub kind: u32,
    /// Bits of events.
    pub events: u32,
    /// The body.
    pub body: RhumbBody,
    /// A position, velocity, force, torque, impulse or gravity, in world axes, as the kind says.
    pub vector: [f32; 3],
    /// Where a force or an impulse acts, in world axes.
    pub point: [f32; 3],
    /// Angular velocity, rad/s about world axes.
    pub angular: [f32; 3],
    /// Unit quaternion x, y, z, w: body to world.
    pub rotation: [f32; 4],
    /// A number, as the kind says.
    pub number: f32,
    /// A number of an enumeration, as the kind says.
    pub choice: u32,
}

impl RhumbCommandKind {
    /// In the order of their numbers.
    pub(crate) const EACH: [Self; @count@] = [@each@];
}

impl RhumbCommand {
    /// The command, in the scene's coordinates.
    pub(crate) fn command(&self) -> Result<Command, BindingError> {
        let kind = RhumbCommandKind::EACH.into_iter().find(|kind| *kind as u32 == self.kind);
        let needed = \"one that RhumbCommandKind names\";
        let kind = kind.ok_or_else(|| BindingError::value(\"command.kind\", self.kind, needed))?;
        let id = || parse_packed_id(self.body.0);
        let vector = Vec3::from_array(self.vector);
        Ok(match kind {
@commands@
        })
    }

    fn active_events(&self) -> Result<ActiveEvents, BindingError> {
        let is_on = |bit: u32| self.events & bit != 0;
        if self.events > @all_bits@ {
            let needed = \"bits that the header names: 0 to @all_bits@\";
            return Err(BindingError::value(\"command.events\", self.events, needed));
        }
        Ok(ActiveEvents {
@events@
        })
    }
}

@records@
@calls@
@event_kinds@
@request_kinds@";

/// `bindings/c/src/generated.rs`.
#[must_use]
pub fn generated(table: &Table) -> String {
    let flat: Vec<_> = table.calls.iter().filter(|call| call.is_flat()).collect();
    let others = table.calls.iter().filter(|call| !call.is_flat());
    let each: Vec<_> = flat
        .iter()
        .map(|call| format!("Self::{}", call.name()))
        .collect();
    let kind = |call: &&Call| {
        let doc = sentence(call, |field| slot(call, field));
        comment("    ///", &doc) + &format!("{} = {},\n", call.name(), call.code)
    };
    let (bits, events) = events_of(table.record("active events"));
    let all = |each: &dyn Fn(&ValueRecord) -> String| table.made().map(each).collect::<String>();
    let texts = [
        ("bits", bits),
        ("events", events),
        ("all_bits", "15".to_owned()),
        ("kinds", flat.iter().map(kind).collect()),
        ("choices", flat.iter().map(|call| choices(call)).collect()),
        ("count", flat.len().to_string()),
        ("each", each.join(", ")),
        ("commands", flat.iter().map(|call| command(call)).collect()),
        ("records", all(&record)),
        ("calls", others.map(function).collect()),
        (
            "event_kinds",
            kinds_of(("an event", "EventKind", "event"), "", &EVENTS),
        ),
        (
            "request_kinds",
            kinds_of(("a request", "RequestKind", "request"), ACCEPTED, &REQUESTS),
        ),
    ];
    fill(
        HEAD,
        &texts.each_ref().map(|(name, text)| (*name, text.as_str())),
    )
}

/// The effect of a call and the meaning of each field, under the name that a language has for it.
pub(crate) fn sentence(call: &Call, name: impl Fn(&CallField) -> String) -> String {
    let of = |field: &&CallField| {
        let name = name(field);
        (!field.doc.is_empty()).then(|| format!("`{name}`: {}", meaning(field, Lengths::OfScene)))
    };
    let fields: Vec<_> = call.fields.iter().filter_map(|field| of(&field)).collect();
    match fields.is_empty() {
        true => call.doc.clone(),
        false => format!("{} {}.", call.doc, fields.join("; ")),
    }
}

/// The field of the flat command that has a field.
pub(crate) fn slot(call: &Call, field: &CallField) -> String {
    let mut vectors = call
        .fields
        .iter()
        .filter(|field| field.kind == FieldKind::Vector);
    let is_first = vectors.next().is_some_and(|first| first.name == field.name);
    let slot = match (&field.kind, field.unit.as_deref()) {
        (FieldKind::Vector, _) if is_first => "vector",
        (FieldKind::Vector, Some("rad/s")) => "angular",
        (FieldKind::Vector, Some("m")) => "point",
        (FieldKind::Rotation, _) => "rotation",
        (FieldKind::Number, _) => "number",
        (FieldKind::Choice(_), _) => "choice",
        (FieldKind::Record(_), _) => "events",
        _ => panic!(
            "no field of RhumbCommand holds {} of {}",
            field.name, call.command
        ),
    };
    slot.to_owned()
}

/// The name of the enumeration of a choice.
pub(crate) fn choice_name(call: &Call, field: &CallField) -> String {
    pascal(&call.call) + &pascal(&field.name)
}

/// The enumerations of a call.
fn choices(call: &Call) -> String {
    let mut written = String::new();
    for field in &call.fields {
        let FieldKind::Choice(words) = &field.kind else {
            continue;
        };
        let name = choice_name(call, field);
        let doc = format!(
            "{}, a choice of the command `{}`.",
            capital(&field.doc),
            call.name()
        );
        written += &comment("///", &doc);
        written += "#[repr(u32)]\n#[derive(Clone, Copy, Debug, PartialEq, Eq)]\n";
        written += &format!("pub enum Rhumb{name} {{\n");
        for [word, doc] in words {
            written += &(comment("    ///", doc) + &format!("{},\n", pascal(word)));
        }
        written += "}\n\n";
        let each = words
            .iter()
            .map(|[word, _]| format!("{name}::{}", pascal(word)));
        let each = each.collect::<Vec<_>>().join(", ");
        written += &format!(
            "/// In the order of their numbers.\nconst {}: [{name}; {}] = [{each}];\n\n",
            snake(&format!("{} {}", call.call, field.name)).to_uppercase(),
            words.len()
        );
    }
    written
}

/// The command of a kind.
fn command(call: &Call) -> String {
    let mut fields = match call.of {
        Owner::Body => "id: id()?,\n".to_owned(),
        Owner::Scene => String::new(),
    };
    for field in &call.fields {
        let name = field.snake();
        let slot = slot(call, field);
        let value = match &field.kind {
            FieldKind::Vector if slot == "vector" => "vector".to_owned(),
            FieldKind::Vector => format!("Vec3::from_array(self.{slot})"),
            FieldKind::Rotation => format!("Quat::from_array(self.{slot})"),
            FieldKind::Record(_) => "self.active_events()?".to_owned(),
            FieldKind::Choice(_) => {
                let each = snake(&format!("{} {}", call.call, field.name)).to_uppercase();
                format!("one_of(&{each}, self.choice, \"command.choice\")?")
            }
            _ => format!("self.{slot}"),
        };
        fields += &format!("{name}: {value},\n");
    }
    let name = call.name();
    format!("RhumbCommandKind::{name} => Command::{name} {{ {fields} }},\n")
}

/// The use of requests, behind the first sentence of their kinds.
const ACCEPTED: &str = " Those that move a body are answered by what is fed; those that add, change or remove something \
    change the scene once they are accepted.";

const KINDS: &str = "\
@doc@\
#[repr(u32)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rhumb@name@ {
    /// There was no @one@.
    None,
@kinds@
}

impl Rhumb@name@ {
    pub(crate) const fn of(kind: @name@) -> Self {
        match kind {
@arms@
        }
    }
}
";

/// An enumeration of kinds, and zero for none.
fn kinds_of((what, name, one): (&str, &str, &str), more: &str, of: &[Reported]) -> String {
    let kind = |of: &Reported| comment("    ///", of.doc) + &format!("{},\n", pascal(of.name));
    let arm = |of: &str| format!("{name}::{of} => Self::{of},\n");
    fill(
        KINDS,
        &[
            (
                "doc",
                &comment("///", &format!("The kind of {what}.{more}")),
            ),
            ("name", name),
            ("one", one),
            ("kinds", &of.iter().map(kind).collect::<String>()),
            (
                "arms",
                &of.iter()
                    .map(|one| arm(&pascal(one.name)))
                    .collect::<String>(),
            ),
        ],
    )
}

/// The bits of events, and how they are read.
fn events_of(record: &ValueRecord) -> (String, String) {
    let (mut bits, mut read) = (String::new(), String::new());
    // The field's bit is the second.
    let mut members: Vec<_> = record.members.iter().collect();
    let place = members
        .iter()
        .position(|member| matches!(member, RecordMember::Optional(_)));
    let optional = members.remove(place.expect("a force"));
    members.insert(1, optional);
    for (place, member) in members.into_iter().enumerate() {
        let (field, value) = match member {
            RecordMember::Optional(field) => (field, "{}.then_some(self.number)"),
            RecordMember::Plain(field) => (field, "{}"),
            RecordMember::Group(group, _) => panic!("{group} has no bit"),
        };
        let (name, bit) = (field.snake(), 1 << place);
        let constant = format!("RHUMB_EVENTS_{}", name.to_uppercase());
        let doc = match member {
            RecordMember::Optional(_) => {
                format!("`number` is the {}", meaning(field, Lengths::OfScene))
            }
            _ => field.doc.clone(),
        };
        bits += &comment("///", &format!("Bit of `events`: {doc}."));
        bits += &format!("pub const {constant}: u32 = {bit};\n");
        let value = value.replace("{}", &format!("is_on({constant})"));
        read += &format!("{name}: {value},\n");
    }
    (bits, read)
}

/// The type of a field of a struct.
fn kind_of(field: &CallField) -> &'static str {
    match field.kind {
        FieldKind::Vector => "[f32; 3]",
        FieldKind::Flag => "u8",
        _ => "f32",
    }
}

/// The struct of a record, and its conversions.
fn record(record: &ValueRecord) -> String {
    let name = pascal(&record.name);
    let mut parts = StructParts::default();
    for member in &record.members {
        parts.add(member, &name);
    }
    let StructParts {
        flags,
        fields,
        to,
        from,
    } = parts;
    let own = match record.is_zero() {
        true => " All zeros are its default.".to_owned(),
        false => format!(" Begin with `rhumb_{}_init`.", snake(&record.name)),
    };
    let doc = comment("///", &(record.doc.clone() + &own));
    let made = match record.is_zero() {
        true => String::new(),
        false => format!(
            "impl From<{name}> for Rhumb{name} {{\nfn from(from: {name}) -> Self {{\nSelf {{\n{from}}}\n}}\n}}\n\n"
        ),
    };
    format!(
        "{doc}#[repr(C)]\n#[derive(Clone, Copy, Debug)]\npub struct Rhumb{name} {{\n{flags}{fields}}}\n\n\
         {made}\
         impl From<&Rhumb{name}> for {name} {{\nfn from(from: &Rhumb{name}) -> Self {{\nSelf {{\n{to}}}\n}}\n}}\n\n"
    )
}

/// The members of a record, written as its struct and as the conversions to Rust's type and from it.
#[derive(Default)]
struct StructParts {
    /// Bytes that say whether something is there, before all others.
    flags: String,
    fields: String,
    to: String,
    from: String,
}

impl StructParts {
    fn add(&mut self, member: &RecordMember, record: &str) {
        match member {
            RecordMember::Plain(field) => {
                let name = field.snake();
                self.fields += &declared(&name, field, &sentence_of(field));
                self.to += &format!("{name}: {},\n", read(field, &format!("from.{name}")));
                self.from += &format!("{name}: {},\n", written(field, &format!("from.{name}")));
            }
            RecordMember::Optional(field) => self.add_optional(field),
            RecordMember::Group(group, parts) => self.add_group(group, parts, record),
        }
    }

    fn add_optional(&mut self, field: &CallField) {
        let name = field.snake();
        self.flags += &format!("/// Not zero: it has `{name}`.\npub has_{name}: u8,\n");
        self.fields += &declared(&name, field, &sentence_of(field));
        let value = read(field, &format!("from.{name}"));
        self.to += &format!("{name}: (from.has_{name} != 0).then_some({value}),\n");
        self.from += &format!("has_{name}: u8::from(from.{name}.is_some()),\n");
        let value = written(field, &format!("from.{name}.unwrap_or_default()"));
        self.from += &format!("{name}: {value},\n");
    }

    fn add_group(&mut self, group: &str, parts: &[CallField], record: &str) {
        let first = parts[0].snake();
        self.flags += &format!(
            "/// Not zero: it has `{first}` and what belongs to it.\npub has_{group}: u8,\n"
        );
        self.from += &format!("has_{group}: u8::from(from.{group}.is_some()),\n");
        let mut inner = String::new();
        for part in parts {
            let (flat, own) = (part.snake(), part.within(group));
            inner += &format!("{own}: {},\n", read(part, &format!("from.{flat}")));
            let value = match part.kind {
                FieldKind::Flag => {
                    let doc = format!("Not zero: {}.", part.doc);
                    self.flags += &declared(&flat, part, &doc);
                    format!("u8::from(from.{group}.is_some_and(|{group}| {group}.{own}))")
                }
                _ => {
                    self.fields += &declared(&flat, part, &sentence_of(part));
                    format!("from.{group}.map_or(0.0, |{group}| {group}.{own})")
                }
            };
            self.from += &format!("{flat}: {value},\n");
        }
        let kind = format!("{record}{}", pascal(group));
        self.to += &format!("{group}: (from.has_{group} != 0).then_some({kind} {{ {inner} }}),\n");
    }
}

fn sentence_of(field: &CallField) -> String {
    capital(&meaning(field, Lengths::OfScene)) + "."
}

fn declared(name: &str, field: &CallField, doc: &str) -> String {
    comment("    ///", doc) + &format!("pub {name}: {},\n", kind_of(field))
}

/// Rust's value of a field of a struct.
fn read(field: &CallField, path: &str) -> String {
    match field.kind {
        FieldKind::Vector => format!("Vec3::from_array({path})"),
        FieldKind::Flag => format!("{path} != 0"),
        _ => path.to_owned(),
    }
}

/// The value of a field of a struct.
fn written(field: &CallField, path: &str) -> String {
    match field.kind {
        FieldKind::Vector => format!("{path}.to_array()"),
        FieldKind::Flag => format!("u8::from({path})"),
        _ => path.to_owned(),
    }
}

/// The function of a call with a record or with several of them.
fn function(call: &Call) -> String {
    let mut doc = format!(
        "Queues a command: {}{}",
        call.doc[..1].to_lowercase(),
        &call.doc[1..]
    );
    let (mut parameters, mut promises, mut made) = (String::new(), String::new(), String::new());
    for field in &call.fields {
        let name = field.snake();
        match &field.kind {
            FieldKind::Record(of) => {
                parameters += &format!("{name}: *const Rhumb{},\n", pascal(of));
                promises += &format!("`{name}` points to one; ");
                made += &format!(
                    "let {name} = {}::from(value({name}, \"{name}\")?);\n",
                    pascal(of)
                );
            }
            FieldKind::List { of, most } => {
                let kind = pascal(of);
                doc += &format!(" `count`: 1 to {most}.");
                if !field.doc.is_empty() {
                    doc += &format!(" `{name}` are {}.", field.doc);
                }
                parameters += &format!("{name}: *const Rhumb{kind},\ncount: usize,\n");
                promises += &format!("`{name}` points to `count` of them; ");
                made += &format!("let {name} = elements({name}, count, \"{name}\")?;\n");
                made += &format!("let {name} = {name}.iter().map({kind}::from).collect();\n");
            }
            _ => panic!("{} of {} belongs into RhumbCommand", field.name, call.call),
        }
    }
    let made_command = crate::core::made(call, &CallField::snake);
    doc += "\n\n`last` may be null; otherwise it receives the number of the command, which events name.";
    doc += &format!(
        "\n\n# Safety\n\n{}`last` is null or points to memory for a number.",
        capital(&promises)
    );
    format!(
        "{}#[unsafe(no_mangle)]\npub unsafe extern \"C\" fn rhumb_scene_{}(\nscene: RhumbScene,\nbody: RhumbBody,\n\
         {parameters}last: *mut u64,\n) -> RhumbCode {{\n// SAFETY: the caller promises what the pointers point to.\n\
         guard(|| unsafe {{\nlet id = parse_packed_id(body.0)?;\n{made}send(scene, {made_command}, last)\n}})\n}}\n\n",
        comment("///", &doc),
        call.call,
    )
}
