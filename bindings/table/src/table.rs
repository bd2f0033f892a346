//! The protocol's table as languages see it, and the texts that they share.
//!
//! It has the commands that the table gives a `call`. Those whose fields are descriptions of shapes, bodies and joints have
//! none: each language has them by hand, see [`BY_HAND`]. The events are those of the protocol, and those of a client itself.

use serde_json::Value;

/// The commands that no table makes calls of.
pub const BY_HAND: [&str; 7] = [
    "AddShape",
    "RemoveShape",
    "AddBody",
    "AddJoint",
    "RemoveJoint",
    "ChangeBody",
    "ChangeJoint",
];

/// The records that commands have, in the order in which files have them.
const RECORDS: [&str; 4] = ["character", "wheel", "wheel input", "active events"];

/// Calls and records.
#[derive(Debug)]
pub struct Table {
    /// In the order of their codes.
    pub calls: Vec<Call>,
    /// Values that calls take.
    pub records: Vec<ValueRecord>,
}

/// The object that has a call.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Owner {
    /// A body.
    Body,
    /// The scene.
    Scene,
}

/// A call of an interface: a command, or one of its alternatives.
#[derive(Clone, Debug)]
pub struct Call {
    /// The command's name, as Rust has it.
    pub command: String,
    /// The command's code.
    pub code: u64,
    /// The alternative that it is of the command, if that has several.
    pub alternative: Option<String>,
    /// Its name in interfaces, in small letters with `_`.
    pub call: String,
    /// The object that has it.
    pub of: Owner,
    /// Its effect: sentences.
    pub doc: String,
    /// Its fields, without the body.
    pub fields: Vec<CallField>,
}

impl Call {
    /// A name in capitals that no other call has: that of the command, or of the call of an alternative.
    #[must_use]
    pub fn name(&self) -> String {
        match &self.alternative {
            Some(_) => pascal(&self.call),
            None => self.command.clone(),
        }
    }

    /// True if all of its fields are numbers, vectors, choices or bits: nothing that has a length or a default of its own.
    #[must_use]
    pub fn is_flat(&self) -> bool {
        let flat = |field: &CallField| match &field.kind {
            FieldKind::Record(name) => name == "active events",
            FieldKind::List { .. } => false,
            _ => true,
        };
        self.alternative.is_none() && self.fields.iter().all(flat)
    }
}

/// The type of a field.
#[derive(Clone, Debug, PartialEq)]
pub enum FieldKind {
    /// Three numbers.
    Vector,
    /// A quaternion x, y, z, w.
    Rotation,
    /// A number of 32 bits.
    Number,
    /// True or false.
    Flag,
    /// One of several words, and what each means.
    Choice(Vec<[String; 2]>),
    /// A record.
    Record(String),
    /// Records of one kind, from one to so many.
    List {
        /// The record.
        of: String,
        /// The greatest number.
        most: String,
    },
}

/// A field of a call or a record.
#[derive(Clone, Debug)]
pub struct CallField {
    /// Its name in words.
    pub name: String,
    /// Its type.
    pub kind: FieldKind,
    /// Its unit, as the table writes it.
    pub unit: Option<String>,
    /// Its meaning, without its unit and bounds; empty for a record.
    pub doc: String,
    /// The numbers that it has where it is left out.
    pub default: Option<Vec<f64>>,
    /// The bounds of each number.
    pub bounds: [Option<f64>; 2],
    /// True for a turn, whose sign is another one in left-handed axes.
    pub is_turn: bool,
}

impl CallField {
    /// Its name with `_`.
    #[must_use]
    pub fn snake(&self) -> String {
        snake(&self.name)
    }

    /// Its name within a group of this name.
    #[must_use]
    pub fn within(&self, group: &str) -> String {
        let own = self.name.strip_prefix(group);
        snake(own.unwrap_or(&self.name).trim_start())
    }
}

/// A part of a record.
#[derive(Clone, Debug)]
pub enum RecordMember {
    /// A field that is always there.
    Plain(CallField),
    /// A field that may be absent.
    Optional(CallField),
    /// Fields that are there or absent together, under one name.
    Group(String, Vec<CallField>),
}

impl RecordMember {
    /// Its fields: one, or those of the group.
    #[must_use]
    pub fn fields(&self) -> &[CallField] {
        match self {
            Self::Plain(field) | Self::Optional(field) => std::slice::from_ref(field),
            Self::Group(_, fields) => fields,
        }
    }
}

/// A value of several fields.
#[derive(Clone, Debug)]
pub struct ValueRecord {
    /// Its name in words.
    pub name: String,
    /// Its meaning: a sentence.
    pub doc: String,
    /// Its parts.
    pub members: Vec<RecordMember>,
}

impl ValueRecord {
    /// Every field, those of groups and flags too, in the order in which they are sent.
    #[must_use]
    pub fn fields(&self) -> Vec<&CallField> {
        self.members.iter().flat_map(RecordMember::fields).collect()
    }

    /// True if every field is a number that is zero where it is left out.
    #[must_use]
    pub fn is_zero(&self) -> bool {
        let mut fields = self.fields().into_iter();
        fields.all(|field| field.default.as_deref() == Some(&[0.0]))
    }

    /// True for a field that has no default, and is always there.
    #[must_use]
    pub fn needs(&self, field: &CallField) -> bool {
        let mut members = self.members.iter();
        field.default.is_none()
            && members
                .any(|member| matches!(member, RecordMember::Plain(own) if own.name == field.name))
    }
}

impl Table {
    /// The table of this repository.
    ///
    /// # Panics
    ///
    /// When the table is not what this crate reads.
    #[must_use]
    pub fn load() -> Self {
        let text = include_str!("../../../spec/tables/protocol.json");
        let table: Value = serde_json::from_str(text).expect("the table is JSON");
        let read = TableReader(&table);
        let commands = table["types"]["command"]["codes"].as_array();
        let calls = commands
            .expect("codes")
            .iter()
            .flat_map(|row| read.calls(row));
        let records = RECORDS.map(|name| read.record(name));
        Self {
            calls: calls.collect(),
            records: records.into(),
        }
    }

    /// The record of a name.
    ///
    /// # Panics
    ///
    /// When there is none.
    #[must_use]
    pub fn record(&self, name: &str) -> &ValueRecord {
        let found = self.records.iter().find(|record| record.name == name);
        found.expect("a record that RECORDS names")
    }

    /// The records that an application makes: all but the bits of events.
    pub fn made(&self) -> impl Iterator<Item = &ValueRecord> {
        let records = self.records.iter();
        records.filter(|record| record.name != "active events")
    }

    /// The calls of an owner, with those of one name together: they differ in the last field of the last.
    #[must_use]
    pub fn merged(&self, of: Owner) -> Vec<Vec<&Call>> {
        let mut merged: Vec<Vec<&Call>> = Vec::new();
        for call in self.calls.iter().filter(|call| call.of == of) {
            match merged.iter_mut().find(|others| others[0].call == call.call) {
                Some(others) => others.push(call),
                None => merged.push(vec![call]),
            }
        }
        merged
    }
}

struct TableReader<'a>(&'a Value);

impl TableReader<'_> {
    fn calls(&self, row: &Value) -> Vec<Call> {
        let command = text(row, "name");
        assert_eq!(
            BY_HAND.contains(&command.as_str()),
            row.get("call").or(row.get("calls")).is_none(),
            "{command} is called in all languages, or is one of those by hand"
        );
        let call = |named: &Value, alternative: Option<String>| Call {
            command: command.clone(),
            code: row["code"].as_u64().expect("a code"),
            call: text(named, "call"),
            of: match row["of"].as_str() {
                Some("scene") => Owner::Scene,
                _ => Owner::Body,
            },
            doc: text(named, "doc"),
            fields: self.fields(&named["fields"]),
            alternative,
        };
        match (row["call"].as_str(), row["calls"].as_str()) {
            (Some(_), _) => vec![call(row, None)],
            (None, Some(of)) => {
                let codes = self.0["types"][of]["codes"].as_array().expect("codes");
                let one = |named: &Value| call(named, Some(text(named, "name")));
                codes.iter().map(one).collect()
            }
            (None, None) => Vec::new(),
        }
    }

    fn fields(&self, fields: &Value) -> Vec<CallField> {
        let fields = fields.as_array().expect("fields").iter();
        let own = fields.filter(|field| field["type"] != "body id");
        own.map(|field| self.field(field)).collect()
    }

    fn field(&self, field: &Value) -> CallField {
        let doc = field["doc"].as_str().unwrap_or_default().to_owned();
        CallField {
            name: match field["call"].as_str() {
                Some(call) => call.replace('_', " "),
                None => text(field, "name"),
            },
            kind: self.kind(field),
            unit: field["unit"].as_str().map(str::to_owned),
            doc,
            default: self.default(&field["default"]),
            bounds: [self.limit(&field["from"]), self.limit(&field["to"])],
            is_turn: field.get("about").is_some(),
        }
    }

    fn kind(&self, field: &Value) -> FieldKind {
        if let Some(times) = field["times"].as_array() {
            let most = self.limit(&times[2]).expect("a limit");
            return FieldKind::List {
                of: times[0].as_str().expect("a record").to_owned(),
                most: number(most),
            };
        }
        let words = |key: &str| {
            let words = field[key].as_array().expect("words").iter();
            words.map(|word| word.as_str().expect("a word").to_owned())
        };
        match field["type"].as_str().expect("a type") {
            "vec3" => FieldKind::Vector,
            "quat" => FieldKind::Rotation,
            "f32" => FieldKind::Number,
            "u8" => FieldKind::Choice(words("names").zip(words("docs")).map(Into::into).collect()),
            record => FieldKind::Record(record.to_owned()),
        }
    }

    fn record(&self, name: &str) -> ValueRecord {
        let row = &self.0["types"][name];
        let mut fields = row["fields"].as_array().expect("fields").as_slice();
        let mut bits: &[Value] = &[];
        if let Some(named) = fields[0]["bits"].as_array() {
            (bits, fields) = (named, &fields[1..]);
        }
        let mut members: Vec<RecordMember> = Vec::new();
        let mut grouped: Vec<(String, CallField)> = Vec::new();
        // A bit that has no field is one.
        for bit in bits.iter().filter(|bit| bit.get("doc").is_some()) {
            let flag = CallField {
                name: text(bit, "name"),
                kind: FieldKind::Flag,
                unit: None,
                doc: text(bit, "doc"),
                default: Some(vec![0.0]),
                bounds: [None, None],
                is_turn: false,
            };
            match bit["of"].as_str() {
                Some(group) => grouped.push((group.to_owned(), flag)),
                None => members.push(RecordMember::Plain(flag)),
            }
        }
        for row in fields {
            let field = self.field(row);
            let Some(mask) = row["when"][1].as_u64() else {
                members.push(RecordMember::Plain(field));
                continue;
            };
            let name = text(&bits[mask.trailing_zeros() as usize], "name");
            match group(&mut members, &name) {
                Some(fields) => fields.push(field),
                None if name == field.name => members.push(RecordMember::Optional(field)),
                None => members.push(RecordMember::Group(name, vec![field])),
            }
        }
        for (name, flag) in grouped {
            let fields = group(&mut members, &name);
            fields.expect("a group of fields").push(flag);
        }
        ValueRecord {
            name: name.to_owned(),
            doc: text(row, "doc"),
            members,
        }
    }

    /// A number, or a limit by its name.
    fn limit(&self, value: &Value) -> Option<f64> {
        let value = value.as_str().map_or(value, |name| &self.0["limits"][name]);
        value.as_f64()
    }

    fn default(&self, value: &Value) -> Option<Vec<f64>> {
        match value.as_array() {
            Some(numbers) => numbers.iter().map(Value::as_f64).collect(),
            None => self.limit(value).map(|number| vec![number]),
        }
    }
}

fn group<'a>(members: &'a mut [RecordMember], name: &str) -> Option<&'a mut Vec<CallField>> {
    members.iter_mut().find_map(|member| match member {
        RecordMember::Group(group, fields) if group == name => Some(fields),
        _ => None,
    })
}

fn text(of: &Value, key: &str) -> String {
    let text = of[key].as_str();
    text.unwrap_or_else(|| panic!("{} without {key}", bare(&of.to_string())))
        .to_owned()
}

/// The units in which a language has lengths.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lengths {
    /// Metres.
    Metres,
    /// The unit of length of a scene's coordinates.
    OfScene,
}

/// The meaning of a field, with its unit and its bounds, without a full stop.
#[must_use]
pub fn meaning(field: &CallField, lengths: Lengths) -> String {
    let mut meaning = field.doc.clone();
    if field.is_turn && lengths == Lengths::OfScene {
        meaning += ", in left-handed coordinates to the right";
    }
    let unit = field.unit.as_deref().unwrap_or_default();
    let symbol = symbol(unit);
    let scaled = match lengths {
        Lengths::Metres => "",
        Lengths::OfScene => in_scene(unit),
    };
    if !scaled.is_empty() {
        meaning += &format!(", {scaled}");
    }
    let bounds = bounds(field);
    match (bounds.is_empty(), scaled.is_empty() && !symbol.is_empty()) {
        (false, _) if field.kind == FieldKind::Vector => {
            meaning += &format!(": {bounds} {symbol} along each axis");
        }
        (false, _) => meaning += &format!(": {bounds} {symbol}"),
        (true, true) => meaning += &format!(", {symbol}"),
        (true, false) => {}
    }
    meaning.trim_end().to_owned()
}

fn bounds(field: &CallField) -> String {
    match field.bounds {
        [Some(from), Some(to)] => format!("{} to {}", number(from), number(to)),
        [None, Some(to)] if field.kind == FieldKind::Vector => {
            format!("at most {}", number(to))
        }
        [None, Some(to)] => format!("{} to {}", number(-to), number(to)),
        _ => String::new(),
    }
}

/// A unit as a sentence has it.
#[must_use]
pub fn symbol(unit: &str) -> String {
    unit.replace('2', "²").replace(' ', "·")
}

/// A unit with a length in it, where the coordinates have their own.
fn in_scene(unit: &str) -> &'static str {
    match unit {
        "m" => "units of length",
        "m/s" => "units of length per second",
        "m/s2" => "units of length per s²",
        "N" => "kg times units of length per s²",
        "N s" => "kg times units of length per second",
        "N m" => "kg times units of length² per s²",
        "N m s" => "kg times units of length² per second",
        _ => "",
    }
}

/// A kind of events or requests: its name in words, and what it says.
#[derive(Clone, Copy, Debug)]
pub struct Reported {
    /// In small letters.
    pub name: &'static str,
    /// A sentence, in which fields of the record have accents.
    pub doc: &'static str,
}

const fn reported(name: &'static str, doc: &'static str) -> Reported {
    Reported { name, doc }
}

/// All of them, in the order of their numbers.
pub const EVENTS: [Reported; 30] = [
    reported(
        "commands applied",
        "All commands up to `number` were applied or refused; they act in the step after `tick`.",
    ),
    reported(
        "command refused",
        "The command `number` was refused; `text` says why, and `body` is one that the reason names.",
    ),
    reported(
        "body placed",
        "`body` was placed in the scene, or its description was replaced.",
    ),
    reported("body removed", "`body` was removed; `text` says why."),
    reported("contact began", "`body` and `other` began to touch."),
    reported(
        "contact ended",
        "`body` and `other` ceased to touch, or one of them was removed.",
    ),
    reported(
        "contact force",
        "The force between `body` and `other` reached the threshold of one of them.",
    ),
    reported("sensor entered", "`other` entered the sensor `body`."),
    reported("sensor left", "`other` left the sensor `body`."),
    reported("fell asleep", "`body` fell asleep."),
    reported("woke", "`body` woke."),
    reported(
        "body fault",
        "The state of `body` was not finite, and it was removed.",
    ),
    reported(
        "reached ground",
        "The character `body` reached ground that carries it.",
    ),
    reported(
        "left ground",
        "No ground carries the character `body` any more.",
    ),
    reported(
        "events missed",
        "So many events of bodies as `number` says were not kept.",
    ),
    reported(
        "stream changed",
        "The stream changed, by request or because of the link.",
    ),
    reported(
        "publisher silent",
        "The server receives nothing from the member with authority over `body`: from `tick` on its pose is a guess, and its error bound is infinite.",
    ),
    reported(
        "publisher active",
        "It receives from that member again, or its authority has ended: from `tick` on `body` has an error bound.",
    ),
    reported(
        "scene restored",
        "The engine failed, and the scene continues from `tick` without the commands that it failed on.",
    ),
    reported(
        "scene faulted",
        "The engine failed, and the scene stands still after `tick`.",
    ),
    reported("scene deleted", "The scene was deleted."),
    reported(
        "interrupted",
        "The connection ended, and the client tries to resume.",
    ),
    reported(
        "resumed",
        "The client continues with its session over another connection.",
    ),
    reported(
        "session lost",
        "The server does not know the session any more.",
    ),
    reported(
        "durable",
        "The scene up to `tick` survives a crash of the server.",
    ),
    reported(
        "authority granted",
        "The server granted authority: as many bodies as `number` says are published. Of a member by cells, more may follow.",
    ),
    reported(
        "authority denied",
        "The server denied authority; `text` says why, and `body` is one that the reason names.",
    ),
    reported("denied", "The server denied a request; `text` says why."),
    reported("ended", "The connection ended; `text` says why."),
    reported(
        "other",
        "An event that bindings do not describe further; `text` names it.",
    ),
];

/// The requests of followers to a scene that a program feeds, in the order of their numbers.
pub const REQUESTS: [Reported; 15] = [
    reported(
        "add body",
        "A new body, of an id that it has already: `body`, `position`, `rotation`, `linear_velocity`, `angular_velocity`. \
         Once it is accepted, feed it.",
    ),
    reported("remove body", "The removal of `body`."),
    reported("change body", "Other properties of `body`."),
    reported("set pose", "`body` at `position` and `rotation`."),
    reported(
        "set velocity",
        "`body` with `linear_velocity` and `angular_velocity`.",
    ),
    reported(
        "apply force",
        "A force for one tick: `vector`, at `point` if it has one.",
    ),
    reported("apply torque", "A torque for one tick: `vector`."),
    reported(
        "apply impulse",
        "A change of momentum: `vector`, at `point` if it has one.",
    ),
    reported(
        "apply torque impulse",
        "A change of angular momentum: `vector`.",
    ),
    reported("sleep", "`body` asleep."),
    reported("wake", "`body` awake."),
    reported("set gravity", "Another gravity: `vector`."),
    reported("add joint", "A new joint; `body` is its first one."),
    reported(
        "change joint",
        "Other limits and motors of a joint; `body` is its first one.",
    ),
    reported("remove joint", "The removal of a joint."),
];

/// Columns of a comment.
const WIDTH: usize = 120;

/// Words with `_` between them.
#[must_use]
pub fn snake(words: &str) -> String {
    words.replace([' ', '-'], "_")
}

/// Words of a name in capitals, such as `SetPose`, with `_` between them.
#[must_use]
pub fn snake_of_pascal(name: &str) -> String {
    let mut snake = String::new();
    for letter in name.chars() {
        if letter.is_uppercase() && !snake.is_empty() {
            snake.push('_');
        }
        snake.extend(letter.to_lowercase());
    }
    snake
}

/// Words that each begin with a capital.
#[must_use]
pub fn pascal(words: &str) -> String {
    words.split([' ', '_', '-']).map(capital).collect()
}

/// Words that each but the first begin with a capital.
#[must_use]
pub fn camel(words: &str) -> String {
    let name = pascal(words);
    name[..1].to_lowercase() + &name[1..]
}

/// A text with a capital.
#[must_use]
pub fn capital(text: &str) -> String {
    let mut letters = text.chars();
    let first = letters
        .next()
        .map(|letter| letter.to_uppercase().to_string());
    first.unwrap_or_default() + letters.as_str()
}

/// The beginning of a text.
#[must_use]
pub fn bare(text: &str) -> &str {
    text.get(..80).unwrap_or(text)
}

/// A template with the values of its names, which stand in it as `@name@`.
#[must_use]
pub fn fill(template: &str, values: &[(&str, &str)]) -> String {
    let mut filled = template.to_owned();
    for (name, value) in values {
        filled = filled.replace(&format!("@{name}@"), value);
    }
    filled
}

/// Lines of at most so many columns.
#[must_use]
pub fn wrapped(text: &str, columns: usize) -> Vec<String> {
    let mut lines = vec![String::new()];
    for word in text.split(' ') {
        let line = lines.last_mut().expect("a line");
        if !line.is_empty() && line.chars().count() + 1 + word.chars().count() > columns {
            lines.push(word.to_owned());
        } else {
            let gap = if line.is_empty() { "" } else { " " };
            line.extend([gap, word]);
        }
    }
    lines
}

/// Lines of a comment, each after `start`, wrapped.
#[must_use]
pub fn comment(start: &str, text: &str) -> String {
    let columns = WIDTH - start.chars().count() - 1;
    let lines = text
        .split('\n')
        .flat_map(|paragraph| wrapped(paragraph, columns));
    lines
        .map(|line| format!("{start} {line}").trim_end().to_owned() + "\n")
        .collect()
}

/// A number as a sentence has it.
#[must_use]
pub fn number(value: f64) -> String {
    use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};
    for (known, written) in [(PI, "π"), (FRAC_PI_2, "π/2"), (FRAC_PI_4, "π/4")] {
        if (value.abs() - known).abs() < 1e-6 {
            let sign = if value < 0.0 { "-" } else { "" };
            return format!("{sign}{written}");
        }
    }
    let written = value.to_string();
    let (whole, rest) = written.split_at(written.find('.').unwrap_or(written.len()));
    let mut grouped = String::new();
    for (place, digit) in whole.chars().enumerate() {
        let left = whole.len() - place;
        if place > 0 && left.is_multiple_of(3) && !grouped.ends_with('-') {
            grouped.push(',');
        }
        grouped.push(digit);
    }
    grouped + rest
}

/// A file, or what stands in one between two lines that name it.
#[derive(Debug)]
pub struct MadePart {
    /// The name between `>>> ` and `, made by bindings/table`; none of a whole file.
    pub name: Option<&'static str>,
    /// The text.
    pub text: String,
}

impl MadePart {
    /// The text between the two lines of this name.
    #[must_use]
    pub const fn named(name: &'static str, text: String) -> Self {
        Self {
            name: Some(name),
            text,
        }
    }

    /// A whole file.
    #[must_use]
    pub fn whole(text: String) -> Vec<Self> {
        vec![Self { name: None, text }]
    }

    /// The text of a file with this part in it.
    ///
    /// # Panics
    ///
    /// When the file lacks the lines between which the part stands.
    #[must_use]
    pub fn placed(&self, file: &str) -> String {
        let Some(name) = self.name else {
            return self.text.clone();
        };
        let begin = file.find(&format!(">>> {name}, made by bindings/table"));
        let end = file.find(&format!("<<< {name}\n"));
        let (Some(begin), Some(end)) = (begin, end) else {
            panic!("the lines of {name} are missing");
        };
        let after = begin + file[begin..].find('\n').unwrap_or_default() + 1;
        let before = file[..end].rfind('\n').unwrap_or_default() + 1;
        [&file[..after], &self.text, &file[before..]].concat()
    }
}
