//! Commands out of JSON, and their types in TypeScript.

use crate::core::made;
use crate::table::{
    Call, CallField, FieldKind, Lengths, MadePart, Owner, RecordMember, Table, ValueRecord, camel,
    capital, fill, meaning, number, pascal, snake, wrapped,
};

const HEAD: &str = "\
//! Commands out of JSON, in the words of `rhumb.d.ts`.
//!
//! Made by `bindings/table` from `spec/tables/protocol.json`; do not edit.

use glam::{Quat, Vec3};
use rhumb_protocol::scene::{
    ActiveEvents, Character, CharacterStep, Command, JumpFrom, Locomotion, Vehicle, Wheel, WheelInput,
};

use crate::argument::{Argument, Failure};

/// A command of a kind; `None` for a kind that is not one of these.
pub(crate) fn command(from: &Argument<'_>, kind: &str) -> Result<Option<Command>, Failure> {
    Ok(Some(match kind {
@commands@\
        _ => return command_of_records(from, kind),
    }))
}

/// The same of commands that have records.
fn command_of_records(from: &Argument<'_>, kind: &str) -> Result<Option<Command>, Failure> {
    Ok(Some(match kind {
@others@\
        _ => return Ok(None),
    }))
}

@records@
";

/// `bindings/web/src/generated.rs`.
#[must_use]
pub fn generated(table: &Table) -> String {
    let merged = merged(table).into_iter();
    let (flat, others): (Vec<_>, Vec<_>) = merged.partition(|calls| calls[0].is_flat());
    let arms = |calls: &[Vec<&Call>]| calls.iter().map(|calls| arm(calls)).collect::<String>();
    let choices = table.calls.iter().map(choices);
    let records = choices.chain(table.records.iter().map(record));
    let records: String = records.collect();
    fill(
        HEAD,
        &[
            ("commands", &arms(&flat)),
            ("others", &arms(&others)),
            ("records", &records),
        ],
    )
}

/// The parts of `bindings/web/rhumb.d.ts`.
#[must_use]
pub fn types(table: &Table) -> Vec<MadePart> {
    let part = MadePart::named;
    vec![
        part("records", table.records.iter().map(interface).collect()),
        part(
            "commands",
            merged(table).iter().map(|calls| variant(calls)).collect(),
        ),
    ]
}

fn merged(table: &Table) -> Vec<Vec<&Call>> {
    let mut calls = table.merged(Owner::Body);
    calls.extend(table.merged(Owner::Scene));
    calls
}

/// The arm of calls of one name.
fn arm(calls: &[&Call]) -> String {
    let kind = camel_of(calls[0]);
    let command = |call: &Call, extra: Option<&str>| {
        made(call, &|field| match extra {
            Some(extra) if field.snake() == extra => format!("{extra}.vector()?"),
            _ => value(call, field),
        })
        .replacen("{ id", "{ id: from.id()?", 1)
    };
    let made = match calls {
        [call] => command(call, None),
        [plain, extended] => {
            let extra = extended.fields[plain.fields.len()].snake();
            format!(
                "match from.optional({extra:?}) {{\nSome({extra}) => {},\nNone => {},\n}}",
                command(extended, Some(&extra)),
                command(plain, None)
            )
        }
        _ => panic!("three commands of one call"),
    };
    format!("{kind:?} => {made},\n")
}

fn camel_of(call: &Call) -> String {
    let name = call.name();
    name[..1].to_lowercase() + &name[1..]
}

/// Code that reads the value of a field.
fn value(call: &Call, field: &CallField) -> String {
    let name = camel(&field.name);
    let default = field.default.as_deref();
    match (&field.kind, default) {
        (FieldKind::Vector, None) => format!("from.vector_of({name:?})?"),
        (FieldKind::Vector, Some(_)) => format!("from.vector_or({name:?}, Vec3::ZERO)?"),
        (FieldKind::Rotation, _) => format!("from.rotation_or({name:?}, Quat::IDENTITY)?"),
        (FieldKind::Number, None) => format!("from.number_of({name:?})?"),
        (FieldKind::Number, Some(default)) => {
            format!("from.number_or({name:?}, {:?})?", default[0])
        }
        (FieldKind::Choice(_), _) => format!("{}(from)?", choice_of(call, field)),
        (FieldKind::Record(of), _) => format!("{}(&from.field({name:?})?)?", snake(of)),
        (FieldKind::List { of, .. }, _) => format!("from.field({name:?})?.each({})?", snake(of)),
        (FieldKind::Flag, _) => format!("from.flag_or({name:?}, false)?"),
    }
}

/// The name of the function that reads a choice.
fn choice_of(call: &Call, field: &CallField) -> String {
    snake(&format!("{} {}", call.call, field.name))
}

/// The functions that read the choices of a call.
fn choices(call: &Call) -> String {
    let mut written = String::new();
    for field in &call.fields {
        let FieldKind::Choice(words) = &field.kind else {
            continue;
        };
        let (own, kind) = (choice_of(call, field), crate::c::choice_name(call, field));
        let arm = |[word, _]: &[String; 2]| {
            format!("Some({:?}) => {kind}::{},\n", camel(word), pascal(word))
        };
        let arms: String = words.iter().map(arm).collect();
        let wanted: Vec<_> = words.iter().map(|[word, _]| camel(word)).collect();
        written += &fill(
            CHOICE,
            &[
                ("own", &own),
                ("kind", &kind),
                ("name", &camel(&field.name)),
                ("first", &pascal(&words[0][0])),
                ("arms", &arms),
                ("wanted", &wanted.join(" or ")),
            ],
        );
    }
    written
}

const CHOICE: &str = "\
fn @own@(from: &Argument<'_>) -> Result<@kind@, Failure> {
    let Some(from) = from.optional(\"@name@\") else {
        return Ok(@kind@::@first@);
    };
    Ok(match from.as_text() {
@arms@        _ => return Err(from.wrong(\"@wanted@\")),
    })
}

";

/// The function that reads a record.
fn record(record: &ValueRecord) -> String {
    let (name, own) = (pascal(&record.name), snake(&record.name));
    let needed: Vec<_> = record
        .fields()
        .into_iter()
        .filter(|field| record.needs(field))
        .collect();
    let read = |field: &&CallField| match field.kind {
        FieldKind::Vector => format!("from.vector_of({:?})?", camel(&field.name)),
        _ => format!("from.number_of({:?})?", camel(&field.name)),
    };
    let plain = match (record.name == "active events", needed.is_empty()) {
        (true, _) => format!("{name}::NONE"),
        (_, true) => format!("{name}::default()"),
        (_, false) => format!(
            "{name}::at({})",
            needed.iter().map(read).collect::<Vec<_>>().join(", ")
        ),
    };
    let is_number = |member: &&RecordMember| {
        matches!(member, RecordMember::Plain(field)
            if field.kind == FieldKind::Number && !record.needs(field))
    };
    let (numbers, others): (Vec<_>, Vec<_>) = record.members.iter().partition(is_number);
    let numbers: Vec<&CallField> = numbers.into_iter().flat_map(RecordMember::fields).collect();
    let is_needed = |member: &&&RecordMember| matches!(member, RecordMember::Plain(field) if record.needs(field));
    let rest = if needed.is_empty() { "" } else { "..plain" };
    let others = others.iter().filter(|member| !is_needed(member));
    let others: String = others.map(|member| member_of(&name, member)).collect();
    let names: Vec<_> = numbers.iter().map(|field| field.snake()).collect();
    let each: Vec<_> = numbers
        .iter()
        .map(|field| format!("({:?}, plain.{})", camel(&field.name), field.snake()))
        .collect();
    let numbers = match names.is_empty() {
        true => String::new(),
        false => format!(
            "let [{}] = from.numbers([{}])?;\n",
            names.join(", "),
            each.join(", ")
        ),
    };
    let names: String = names.iter().map(|name| format!("{name},\n")).collect();
    format!(
        "fn {own}(from: &Argument<'_>) -> Result<{name}, Failure> {{\nlet plain = {plain};\n{numbers}Ok({name} {{\n{names}{others}{rest}\n}})\n}}\n\n"
    )
}

/// Code that reads a member which is no number with a default.
fn member_of(record: &str, member: &RecordMember) -> String {
    match member {
        RecordMember::Plain(field) => {
            let (own, name) = (field.snake(), camel(&field.name));
            let method = match field.kind {
                FieldKind::Vector => "vector_or",
                _ => "flag_or",
            };
            format!("{own}: from.{method}({name:?}, plain.{own})?,\n")
        }
        RecordMember::Optional(field) if field.default.is_some() => {
            let (own, name) = (field.snake(), camel(&field.name));
            format!(
                "{own}: Some(from.number_or({name:?}, plain.{own}.unwrap_or_default())?)\
                 .filter(|{own}| *{own} != 0.0),\n"
            )
        }
        RecordMember::Optional(field) => {
            let (own, name) = (field.snake(), camel(&field.name));
            let method = match field.kind {
                FieldKind::Vector => "vector",
                _ => "single",
            };
            format!("{own}: from.optional({name:?}).map(|from| from.{method}()).transpose()?,\n")
        }
        RecordMember::Group(group, fields) => {
            let inner = fields.iter().map(|field| {
                let own = field.within(group);
                let name = camel(&own);
                match field.kind {
                    FieldKind::Flag => format!("{own}: from.flag_or({name:?}, false)?,\n"),
                    _ => format!("{own}: from.number_of({name:?})?,\n"),
                }
            });
            let kind = format!("{record}{}", pascal(group));
            format!(
                "{group}: from.optional({group:?}).map(|from| Ok::<_, Failure>({kind} {{ {} }})).transpose()?,\n",
                inner.collect::<String>()
            )
        }
    }
}

/// A comment of TypeScript.
fn doc(indent: &str, text: &str) -> String {
    let line = format!("{indent}/** {text} */\n");
    match line.chars().count() <= 121 {
        true => line,
        false => {
            let lines = wrapped(text, 117 - indent.len());
            format!(
                "{indent}/**\n{indent} * {}\n{indent} */\n",
                lines.join(&format!("\n{indent} * "))
            )
        }
    }
}

fn kind_of(field: &CallField) -> String {
    match &field.kind {
        FieldKind::Vector => "Vec3".to_owned(),
        FieldKind::Rotation => "Quat".to_owned(),
        FieldKind::Number => "number".to_owned(),
        FieldKind::Flag => "boolean".to_owned(),
        FieldKind::Choice(words) => {
            let words: Vec<_> = words
                .iter()
                .map(|[word, _]| format!("{:?}", camel(word)))
                .collect();
            words.join(" | ")
        }
        FieldKind::Record(of) => pascal(of),
        FieldKind::List { of, .. } => format!("readonly {}[]", pascal(of)),
    }
}

/// A sentence about a field, with its default.
fn sentence(field: &CallField) -> String {
    let default = match field.default.as_deref() {
        _ if field.kind == FieldKind::Flag => String::new(),
        None => String::new(),
        Some([most]) if Some(*most) == field.bounds[1] => " Default: any.".to_owned(),
        Some([value]) => format!(" Default: {}.", number(*value)),
        Some(values) => {
            let values: Vec<_> = values.iter().map(|value| number(*value)).collect();
            format!(" Default: {}.", values.join(", "))
        }
    };
    format!("{}.{default}", capital(&meaning(field, Lengths::Metres)))
}

/// The type of a record.
fn interface(record: &ValueRecord) -> String {
    let mut fields = String::new();
    for member in &record.members {
        match member {
            RecordMember::Plain(field) => {
                let mark = if record.needs(field) { "" } else { "?" };
                fields += &doc("  ", &sentence(field));
                fields += &format!(
                    "  readonly {}{mark}: {};\n",
                    camel(&field.name),
                    kind_of(field)
                );
            }
            RecordMember::Optional(field) => {
                let none = if field.default.is_some() {
                    " Zero: none."
                } else {
                    ""
                };
                fields += &doc("  ", &(sentence(field) + none));
                fields += &format!("  readonly {}?: {};\n", camel(&field.name), kind_of(field));
            }
            RecordMember::Group(group, parts) => {
                let each = parts.iter().map(|field| {
                    let mark = if field.kind == FieldKind::Flag {
                        "?"
                    } else {
                        ""
                    };
                    format!(
                        "readonly {}{mark}: {}",
                        camel(&field.within(group)),
                        kind_of(field)
                    )
                });
                let docs: Vec<_> = parts
                    .iter()
                    .map(|field| {
                        let meaning = meaning(field, Lengths::Metres);
                        format!("`{}`: {meaning}", camel(&field.within(group)))
                    })
                    .collect();
                fields += &doc("  ", &format!("{}. Default: none.", docs.join("; ")));
                fields += &format!(
                    "  readonly {group}?: {{ {} }};\n",
                    each.collect::<Vec<_>>().join("; ")
                );
            }
        }
    }
    format!(
        "{}export interface {} {{\n{fields}}}\n\n",
        doc("", &record.doc),
        pascal(&record.name)
    )
}

/// The member of the union of commands that calls of one name are.
fn variant(calls: &[&Call]) -> String {
    let last = calls[calls.len() - 1];
    let mut fields = format!("readonly kind: {:?}", camel_of(calls[0]));
    if last.of == Owner::Body {
        fields += "; readonly id: BodyId";
    }
    let mut text = calls[0].doc.clone();
    for (place, field) in last.fields.iter().enumerate() {
        let may_lack = place >= calls[0].fields.len() || field.default.is_some();
        let mark = if may_lack { "?" } else { "" };
        let name = camel(&field.name);
        fields += &format!("; readonly {name}{mark}: {}", kind_of(field));
        let sentence = match &field.kind {
            FieldKind::Choice(words) => format!(
                "{} Default: `{:?}`.",
                capital(&field.doc) + ".",
                camel(&words[0][0])
            ),
            _ => sentence(field),
        };
        if !field.doc.is_empty() {
            text += &format!(
                " `{name}`: {}{}",
                sentence[..1].to_lowercase(),
                &sentence[1..]
            );
        }
    }
    format!("{}  | {{ {fields} }}\n", doc("  ", &text))
}
