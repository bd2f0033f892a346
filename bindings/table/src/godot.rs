//! Methods of Godot's nodes, and the resources that they take.

use crate::core::made;
use crate::table::{
    Call, CallField, FieldKind, Lengths, Owner, RecordMember, Table, ValueRecord, capital, comment,
    fill, meaning, pascal, snake,
};

/// Calls whose name a property of the node has, or its setter.
const RENAMED: [(&str, &str); 3] = [
    ("sleep", "put_to_sleep"),
    ("wake", "wake_up"),
    ("set_gravity", "change_gravity"),
];

const HEAD: &str = "\
//! Commands as methods of nodes, and the resources that they take.
//!
//! Made by `bindings/table` from `spec/tables/protocol.json`; do not edit.

use godot::global::Error;
use godot::prelude::*;
use rhumb_client::scene::{
    ActiveEvents, Character, CharacterStep, Command, JumpFrom, Locomotion, Vehicle, Wheel, WheelInput,
};

use crate::body::BodyNode;
use crate::conversion::{quat, vec3};
use crate::scene::SceneNode;

#[godot_api(secondary)]
impl BodyNode {
@bodies@}

#[godot_api(secondary)]
impl SceneNode {
@scenes@}

@records@
/// The vector, unless it is zero.
fn given(vector: Vector3) -> Option<rhumb_client::glam::Vec3> {
    (vector != Vector3::ZERO).then(|| vec3(vector))
}
";

/// `bindings/godot/src/generated.rs`.
#[must_use]
pub fn generated(table: &Table) -> String {
    let methods = |of: Owner| -> String {
        let calls = table.merged(of).into_iter();
        calls
            .flat_map(|calls| calls.clone().into_iter().map(move |call| (calls[0], call)))
            .map(|(first, call)| method(table, first, call))
            .collect()
    };
    let records: String = table.made().map(resource).collect();
    fill(
        HEAD,
        &[
            ("bodies", &methods(Owner::Body)),
            ("scenes", &methods(Owner::Scene)),
            ("records", &records),
        ],
    )
}

/// The name of a method: a later command of one call has more behind it.
fn name_of(first: &Call, call: &Call) -> String {
    let more = call
        .command
        .strip_prefix(&first.command)
        .unwrap_or_default()
        .to_lowercase();
    let renamed = RENAMED.iter().find(|(name, _)| *name == call.call);
    let name = renamed.map_or(call.call.as_str(), |(_, renamed)| *renamed);
    match more.is_empty() {
        true => name.to_owned(),
        false => format!("{name}_{more}"),
    }
}

/// A method of a node.
fn method(table: &Table, first: &Call, call: &Call) -> String {
    let name = name_of(first, call);
    let mut parameters = String::new();
    let mut doc = comment("    ///", &call.doc);
    for field in &call.fields {
        if let (FieldKind::Record(of), true) = (&field.kind, call.is_flat()) {
            for field in table.record(of).fields() {
                let (kind, default) = match field.kind {
                    FieldKind::Flag => ("bool", "false"),
                    _ => ("f32", "-1.0"),
                };
                let own = field.snake();
                parameters += &format!("#[opt(default = {default})] {own}: {kind},\n");
                let none = if kind == "f32" {
                    "; none if it is negative"
                } else {
                    ""
                };
                doc += &comment(
                    "    ///",
                    &format!("`{own}`: {}{none}.", meaning(field, Lengths::Metres)),
                );
            }
            continue;
        }
        let (own, declared) = declared(field);
        parameters += &declared;
        let meaning = match &field.kind {
            FieldKind::Choice(words) => words[1][1].to_lowercase().trim_end_matches('.').to_owned(),
            _ => meaning(field, Lengths::Metres),
        };
        if !meaning.is_empty() {
            doc += &comment("    ///", &format!("`{own}`: {meaning}."));
        }
    }
    let command = made(call, &|field| value(table, call, field));
    let command = match call.of {
        Owner::Body => format!("|id| {command}"),
        Owner::Scene => command,
    };
    format!(
        "{doc}#[func]\npub(crate) fn {name}(&self, {parameters}) -> Error {{\nself.command({name:?}, {command})\n}}\n\n"
    )
}

/// The name and the declaration of a parameter.
fn declared(field: &CallField) -> (String, String) {
    let own = field.snake();
    let (own, kind) = match &field.kind {
        FieldKind::Vector => (own, "Vector3".to_owned()),
        FieldKind::Rotation => (own, "Quaternion".to_owned()),
        FieldKind::Choice(words) => (words[1][0].clone(), "bool".to_owned()),
        FieldKind::Record(of) => (own, format!("Gd<{}Resource>", pascal(of))),
        FieldKind::List { of, .. } => (own, format!("Array<Gd<{}Resource>>", pascal(of))),
        _ => (own, "f32".to_owned()),
    };
    let default = match (&field.kind, field.default.as_deref()) {
        (FieldKind::Vector, Some(_)) => "#[opt(default = Vector3::ZERO)] ",
        (FieldKind::Rotation, Some(_)) => "#[opt(default = Quaternion::default())] ",
        (FieldKind::Choice(_), Some(_)) => "#[opt(default = false)] ",
        (FieldKind::Number, Some(default)) => {
            &format!("#[opt(default = {})] ", literal(default[0]))
        }
        _ => "",
    };
    let declared = format!("{default}{own}: {kind},\n");
    (own, declared)
}

/// The value of a field in a command.
fn value(table: &Table, call: &Call, field: &CallField) -> String {
    let own = field.snake();
    match &field.kind {
        FieldKind::Vector => format!("vec3({own})"),
        FieldKind::Rotation => format!("quat({own})"),
        FieldKind::Choice(words) => {
            let kind = crate::c::choice_name(call, field);
            let [no, yes] = [&words[0][0], &words[1][0]].map(|word| pascal(word));
            let flag = &words[1][0];
            format!("match {flag} {{ true => {kind}::{yes}, false => {kind}::{no} }}")
        }
        FieldKind::Record(of) if call.is_flat() => {
            let fields = table
                .record(of)
                .fields()
                .into_iter()
                .map(|field| match field.kind {
                    FieldKind::Flag => field.snake(),
                    _ => format!("{0}: ({0} >= 0.0).then_some({0})", field.snake()),
                });
            format!(
                "{} {{ {} }}",
                pascal(of),
                fields.collect::<Vec<_>>().join(", ")
            )
        }
        FieldKind::Record(of) => format!("{own}.bind().{}()", snake(of)),
        FieldKind::List { of, .. } => {
            let one = own.trim_end_matches('s');
            format!(
                "{own}.iter_shared().map(|{one}| {one}.bind().{}()).collect()",
                snake(of)
            )
        }
        _ => own,
    }
}

/// A number as Rust writes it.
fn literal(value: f64) -> String {
    let written = (value as f32).to_string();
    match (value - std::f64::consts::FRAC_PI_4).abs() < 1e-6 {
        true => "std::f32::consts::FRAC_PI_4".to_owned(),
        false if written.contains('.') => written,
        false => format!("{written}.0"),
    }
}

/// A resource.
fn resource(record: &ValueRecord) -> String {
    let (name, own) = (pascal(&record.name), snake(&record.name));
    let (mut properties, mut values) = (String::new(), String::new());
    for member in &record.members {
        match member {
            RecordMember::Plain(field) => {
                properties += &property(field, "");
                values += &format!("{}: {},\n", field.snake(), read(field));
            }
            RecordMember::Optional(field) => {
                properties += &property(field, "; none if it is zero");
                let field_name = field.snake();
                let value = match field.kind {
                    FieldKind::Vector => format!("given(self.{field_name})"),
                    _ => format!("(self.{field_name} != 0.0).then_some(self.{field_name})"),
                };
                values += &format!("{field_name}: {value},\n");
            }
            RecordMember::Group(group, fields) => {
                for (place, field) in fields.iter().enumerate() {
                    let none = if place == 0 {
                        "; none if it is zero"
                    } else {
                        ""
                    };
                    properties += &property(field, none);
                }
                let inner = fields
                    .iter()
                    .map(|field| format!("{}: {},\n", field.within(group), read(field)));
                values += &format!(
                    "{group}: (self.{} != 0.0).then_some({name}{} {{ {} }}),\n",
                    fields[0].snake(),
                    pascal(group),
                    inner.collect::<String>()
                );
            }
        }
    }
    format!(
        "{}#[derive(GodotClass)]\n#[class(init, base = Resource, rename = Rhumb{name})]\npub(crate) struct {name}Resource {{\n{properties}}}\n\n\
         impl {name}Resource {{\nfn {own}(&self) -> {name} {{\n{name} {{\n{values}}}\n}}\n}}\n\n",
        comment("///", &record.doc)
    )
}

fn read(field: &CallField) -> String {
    match field.kind {
        FieldKind::Vector => format!("vec3(self.{})", field.snake()),
        _ => format!("self.{}", field.snake()),
    }
}

fn property(field: &CallField, none: &str) -> String {
    let doc = capital(&meaning(field, Lengths::Metres)) + none + ".";
    let (kind, default) = match (&field.kind, field.default.as_deref()) {
        (FieldKind::Flag, _) => ("bool", None),
        (FieldKind::Vector, Some([x, y, z])) => (
            "Vector3",
            Some(format!(
                "Vector3::new({}, {}, {})",
                literal(*x),
                literal(*y),
                literal(*z)
            )),
        ),
        (FieldKind::Vector, _) => ("Vector3", None),
        (_, Some([value])) if *value != 0.0 => ("f32", Some(literal(*value))),
        _ => ("f32", None),
    };
    let default = default.map_or_else(String::new, |default| format!("#[init(val = {default})]\n"));
    format!(
        "{}#[export]\n{default}{}: {kind},\n",
        comment("    ///", &doc),
        field.snake()
    )
}
