//! Commands and records of the header for C++.

use crate::c::{choice_name, slot};
use crate::table::{
    Call, CallField, FieldKind, Lengths, MadePart, Owner, RecordMember, Table, ValueRecord,
    capital, comment, meaning, pascal, snake, snake_of_pascal,
};

/// The parts of `bindings/c/include/rhumb.hpp`.
#[must_use]
pub fn parts(table: &Table) -> Vec<MadePart> {
    let flat = table.calls.iter().filter(|call| call.is_flat());
    let others = table.calls.iter().filter(|call| !call.is_flat());
    let part = MadePart::named;
    vec![
        part("records", table.made().map(record).collect()),
        part("commands", flat.map(command).collect()),
        part(
            "commands of a scene",
            others.map(|call| method(table, call)).collect(),
        ),
    ]
}

/// A sentence about a call, and a line for each field.
fn doc(indent: &str, call: &Call) -> String {
    let start = format!("{indent}///");
    let mut doc = comment(&start, &call.doc);
    for field in call.fields.iter().filter(|field| !field.doc.is_empty()) {
        doc += &comment(
            &start,
            &format!("{}: {}.", field.snake(), meaning(field, Lengths::OfScene)),
        );
    }
    doc
}

/// A number as C++ writes it.
fn literal(value: f64) -> String {
    let written = value.to_string();
    match written.contains('.') {
        true => format!("{written}F"),
        false => format!("{written}.0F"),
    }
}

fn default(field: &CallField, call: &Call) -> String {
    match (&field.kind, field.default.as_deref()) {
        (_, None) => String::new(),
        (FieldKind::Choice(words), Some(&[value])) => {
            let choice = snake(&format!("{} {}", call.call, field.name));
            format!(
                " = RHUMB_{}_{}",
                choice.to_uppercase(),
                words[value as usize][0].to_uppercase()
            )
        }
        (FieldKind::Number, Some(&[value])) => format!(" = {}", literal(value)),
        (FieldKind::Vector, Some(&[0.0, 0.0, 0.0])) => " = {}".to_owned(),
        (_, Some(values)) => {
            let values: Vec<_> = values.iter().map(ToString::to_string).collect();
            format!(" = {{{}}}", values.join(", "))
        }
    }
}

/// A function that makes a command.
fn command(call: &Call) -> String {
    let mut parameters = Vec::new();
    let mut statements = String::new();
    if call.of == Owner::Body {
        parameters.push("Body body".to_owned());
    }
    for field in &call.fields {
        let (name, slot) = (field.snake(), slot(call, field));
        let default = default(field, call);
        let (kind, statement) = match &field.kind {
            FieldKind::Vector => (
                "Vec3".to_owned(),
                format!("detail::set(command.{slot}, {name});"),
            ),
            FieldKind::Rotation => (
                "Quat".to_owned(),
                format!("detail::set(command.{slot}, {name});"),
            ),
            FieldKind::Choice(_) => (
                format!("Rhumb{}", choice_name(call, field)),
                format!("command.{slot} = static_cast<std::uint32_t>({name});"),
            ),
            FieldKind::Record(_) => {
                parameters.push("std::uint32_t events".to_owned());
                statements += "    command.events = events;\n";
                ("float".to_owned(), "command.number = force;".to_owned())
            }
            _ => ("float".to_owned(), format!("command.{slot} = {name};")),
        };
        match field.kind {
            FieldKind::Record(_) => parameters.push("float force = 0.0F".to_owned()),
            _ => parameters.push(format!("{kind} {name}{default}")),
        }
        statements += &format!("    {statement}\n");
    }
    let doc = match call
        .fields
        .iter()
        .any(|field| matches!(field.kind, FieldKind::Record(_)))
    {
        true => {
            doc("", call)
                + "/// events: RHUMB_EVENTS_ bits. force: from which on contacts are reported, if that bit is set.\n"
        }
        false => doc("", call),
    };
    let kind = snake_of_pascal(&call.name());
    let body = match call.of {
        Owner::Body => "body",
        Owner::Scene => "0",
    };
    let made = format!("make(RHUMB_COMMAND_KIND_{}, {body})", kind.to_uppercase());
    let (parameters, head) = (parameters.join(", "), format!("inline RhumbCommand {kind}"));
    match statements.is_empty() {
        true => format!("{doc}{head}({parameters}) {{ return {made}; }}\n\n"),
        false => format!(
            "{doc}{head}({parameters}) {{\n    RhumbCommand command = {made};\n{statements}    return command;\n}}\n\n"
        ),
    }
}

/// A method of a scene.
fn method(table: &Table, call: &Call) -> String {
    let mut parameters = vec!["Body body".to_owned()];
    let (mut statements, mut arguments) = (String::new(), String::new());
    for field in &call.fields {
        let name = field.snake();
        match &field.kind {
            FieldKind::Record(of) => {
                parameters.push(format!("const {}& {name}", pascal(of)));
                arguments += &format!("&{name}.raw(), ");
            }
            FieldKind::List { of, .. } if table.record(of).is_zero() => {
                parameters.push(format!("const std::vector<{}>& {name}", pascal(of)));
                arguments += &format!("{name}.data(), {name}.size(), ");
            }
            FieldKind::List { of, .. } => {
                let kind = pascal(of);
                let one = name.trim_end_matches('s');
                parameters.push(format!("const std::vector<{kind}>& {name}"));
                statements += &format!(
                    "        std::vector<Rhumb{kind}> raw;\n        raw.reserve({name}.size());\n        \
                     for (const {kind}& {one} : {name}) {{\n            raw.push_back({one}.raw());\n        }}\n"
                );
                arguments += "raw.data(), raw.size(), ";
            }
            _ => panic!("{} of {} belongs into RhumbCommand", field.name, call.call),
        }
    }
    let (name, parameters) = (&call.call, parameters.join(", "));
    format!(
        "{}    std::uint64_t {name}({parameters}) {{\n{statements}        std::uint64_t number = 0;\n        \
         throw_unless_ok(rhumb_scene_{name}(raw_, body, {arguments}&number));\n        return number;\n    }}\n\n",
        doc("    ", call)
    )
}

/// A class that sets the fields of a record.
fn record(record: &ValueRecord) -> String {
    let name = pascal(&record.name);
    let raw = format!("Rhumb{name}");
    if record.is_zero() {
        let doc = comment("///", &format!("{} See {raw}.", record.doc));
        return format!("{doc}using {name} = {raw};\n\n");
    }
    let fields = record.fields();
    let needed: Vec<_> = fields.iter().filter(|field| record.needs(field)).collect();
    let mut parameters: Vec<_> = needed
        .iter()
        .map(|field| format!("{} {}", kind_of(field), field.snake()))
        .collect();
    let mut body = String::new();
    parameters.push("RhumbCoordinates coordinates = RHUMB_COORDINATES_RHUMB".to_owned());
    let init = format!("rhumb_{}_init", snake(&record.name));
    body += &format!(
        "        throw_unless_ok({init}(&raw_, static_cast<std::uint32_t>(coordinates)));\n"
    );
    for field in &needed {
        body += &format!("        {}\n", assigned(field, &field.snake()));
    }
    let parameters = parameters.join(", ");
    let explicit = if needed.is_empty() { "explicit " } else { "" };
    let constructor = format!("    {explicit}{name}({parameters}) {{\n{body}    }}\n\n");
    let members = record.members.iter().map(|member| match member {
        RecordMember::Plain(field) if record.needs(field) => String::new(),
        _ => setter(&name, member),
    });
    let coordinates =
        " Give the coordinates of its scene: what is not set has its default in them.";
    format!(
        "{}class {name} {{\npublic:\n{}{constructor}{}    /// Every field, as rhumb.h names it.\n    \
         {raw}& fields() noexcept {{ return raw_; }}\n    const {raw}& raw() const noexcept {{ return raw_; }}\n\n\
         private:\n    {raw} raw_;\n}};\n\n",
        comment("///", &format!("{}{coordinates}", record.doc)),
        needed
            .iter()
            .map(|field| line_of(field))
            .collect::<String>(),
        members.collect::<String>()
    )
}

/// A line about a parameter.
fn line_of(field: &CallField) -> String {
    comment(
        "    ///",
        &format!("{}: {}.", field.snake(), meaning(field, Lengths::OfScene)),
    )
}

fn kind_of(field: &CallField) -> &'static str {
    match field.kind {
        FieldKind::Vector => "Vec3",
        FieldKind::Flag => "bool",
        _ => "float",
    }
}

/// The statement that sets a field by its name, or by another one.
fn assigned(field: &CallField, from: &str) -> String {
    let name = field.snake();
    match field.kind {
        FieldKind::Vector => format!("detail::set(raw_.{name}, {from});"),
        FieldKind::Flag => format!("raw_.{name} = {from} ? 1 : 0;"),
        _ => format!("raw_.{name} = {from};"),
    }
}

/// The method that sets a member.
fn setter(class: &str, member: &RecordMember) -> String {
    let (name, docs, parameters, statements) = match member {
        RecordMember::Plain(field) => {
            let name = field.snake();
            let parameter = format!("{} {name}", kind_of(field));
            let statement = format!("        {}\n", assigned(field, &name));
            (name, sentence(field), parameter, statement)
        }
        RecordMember::Optional(field) if field.default.is_some() => {
            let name = field.snake();
            let doc = sentence(field) + &comment("    ///", "None: it has none.");
            let parameter = format!("std::optional<{}> {name}", kind_of(field));
            let statements = format!(
                "        raw_.has_{name} = {name} ? 1 : 0;\n        raw_.{name} = {name}.value_or(0.0F);\n"
            );
            (name, doc, parameter, statements)
        }
        RecordMember::Optional(field) => {
            let name = field.snake();
            let parameter = format!("{} {name}", kind_of(field));
            let statements = format!(
                "        raw_.has_{name} = 1;\n        {}\n",
                assigned(field, &name)
            );
            (name, sentence(field), parameter, statements)
        }
        RecordMember::Group(group, fields) => {
            let name = snake(group);
            let mut statements = format!("        raw_.has_{name} = 1;\n");
            let mut parameters = Vec::new();
            let mut docs = String::new();
            for field in fields {
                let default = if field.kind == FieldKind::Flag {
                    " = false"
                } else {
                    ""
                };
                let own = field.within(group);
                parameters.push(format!("{} {own}{default}", kind_of(field)));
                statements += &format!("        {}\n", assigned(field, &own));
                let doc = meaning(field, Lengths::OfScene);
                docs += &comment("    ///", &format!("{own}: {doc}."));
            }
            (name, docs, parameters.join(", "), statements)
        }
    };
    format!(
        "{docs}    {class}& {name}({parameters}) {{\n{statements}        return *this;\n    }}\n\n"
    )
}

fn sentence(field: &CallField) -> String {
    comment(
        "    ///",
        &(capital(&meaning(field, Lengths::OfScene)) + "."),
    )
}
