//! The protocol's table as languages see it: calls, their fields, records.
//!
//! It has the commands that the table gives a `call`. Those whose fields are descriptions of shapes, bodies and joints have
//! none: each language has them by hand, see [`BY_HAND`].

use serde_json::Value;

use crate::text::{bare, number, pascal, snake};

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
