//! Methods of a scene, records and their stubs, of Python.

use crate::c::choice_name;
use crate::core::{made, plain};
use crate::table::{
    Call, CallField, EVENTS, FieldKind, Lengths, MadePart, Owner, RecordMember, Table, ValueRecord,
    fill, meaning, number, pascal, snake, wrapped,
};

const HEAD: &str = "\
//! Commands as methods of a scene, their values as classes of Python.
//!
//! Made by `bindings/table` from `spec/tables/protocol.json`; do not edit. A setting that is left out is that of Rust, in
//! the units and axes of the scene that gets it.

use pyo3::prelude::*;
use rhumb_bindings::Coordinates;
use rhumb_bindings::rhumb_client::BodyId;
use rhumb_bindings::rhumb_client::glam::{Quat, Vec3};
use rhumb_bindings::rhumb_client::scene::{
    ActiveEvents, Character, CharacterStep, Command, JumpFrom, Locomotion, Vehicle, Wheel, WheelInput,
};

use crate::arguments::{bodies, call, number, optional_rows, rows, triple, vector};
use crate::errors::check_in_any;
use crate::number::{optional_real, real, reals};
use crate::scene::PyScene;

#[pymethods]
impl PyScene {
@methods@}

@records@
";

/// `bindings/python/src/generated.rs`.
#[must_use]
pub fn generated(table: &Table) -> String {
    let records: String = table.made().map(|record| class(table, record)).collect();
    let calls = merged(table);
    let methods: String = calls.iter().map(|calls| method(table, calls)).collect();
    fill(HEAD, &[("methods", &methods), ("records", &records)])
}

/// The parts of the stubs.
#[must_use]
pub fn stubs(table: &Table) -> Vec<MadePart> {
    let part = MadePart::named;
    let kinds: Vec<_> = EVENTS
        .iter()
        .map(|event| format!("{:?}", event.name))
        .collect();
    let kinds = format!("One of: {}.", kinds.join(", "));
    let stub = |calls: &Vec<&Call>| {
        let parameters = parameters(table, calls);
        let mut stubs = vec!["self".to_owned()];
        if calls[0].of == Owner::Body {
            stubs.push("body: _Bodies".to_owned());
        }
        stubs.extend(listed(&parameters, Parameter::stub));
        let head = format!(
            "    def {}({}) -> Optional[int]:\n",
            calls[0].call,
            stubs.join(", ")
        );
        broken(&head) + &docstring("        ", &lines_of(calls, &parameters))
    };
    vec![
        part("records", table.made().map(stub_of_class).collect()),
        part(
            "kinds of events",
            docstring("        ", &wrapped(&kinds, 105)),
        ),
        part("commands", merged(table).iter().map(stub).collect()),
    ]
}

fn merged(table: &Table) -> Vec<Vec<&Call>> {
    let mut calls = table.merged(Owner::Body);
    calls.extend(table.merged(Owner::Scene));
    calls
}

/// A parameter of a method.
struct Parameter<'a> {
    field: &'a CallField,
    name: String,
    /// Its default as Python writes it.
    default: Option<&'static str>,
    is_keyword: bool,
}

impl Parameter<'_> {
    /// Its type in a stub, and its default.
    fn stub(&self) -> String {
        let kind = match &self.field.kind {
            FieldKind::Vector => "_Vector",
            FieldKind::Rotation => "_Rotation",
            FieldKind::Number => "float",
            FieldKind::Flag | FieldKind::Choice(_) => "bool",
            FieldKind::Record(of) => &pascal(of),
            FieldKind::List { of, .. } => &format!("Sequence[{}]", pascal(of)),
        };
        let name = &self.name;
        match self.default {
            None => format!("{name}: {kind}"),
            Some("None") => format!("{name}: Optional[{kind}] = None"),
            Some(default) => format!("{name}: {kind} = {default}"),
        }
    }

    /// Its declaration in Rust.
    fn declared(&self) -> String {
        let name = &self.name;
        let kind = match (&self.field.kind, self.default) {
            (FieldKind::Flag | FieldKind::Choice(_), _) => "bool".to_owned(),
            (FieldKind::Record(of), _) => format!("&Bound<'_, Py{}>", pascal(of)),
            (FieldKind::List { of, .. }, _) => format!("Vec<PyRef<'_, Py{}>>", pascal(of)),
            (_, Some("None")) => "Option<&Bound<'_, PyAny>>".to_owned(),
            _ => "&Bound<'_, PyAny>".to_owned(),
        };
        format!("{name}: {kind}")
    }

    fn meaning(&self) -> Option<String> {
        let name = &self.name;
        let meaning = match &self.field.kind {
            FieldKind::Choice(words) => {
                let doc = words[1][1].trim_end_matches('.');
                format!("{}{}", doc[..1].to_lowercase(), &doc[1..])
            }
            _ if self.field.doc.is_empty() => return None,
            _ => meaning(self.field, Lengths::OfScene),
        };
        Some(format!("{name}: {meaning}."))
    }
}

/// The parameters of calls of one name, without the body: those of the first, and what the last has beside them.
fn parameters<'a>(table: &'a Table, calls: &[&'a Call]) -> Vec<Parameter<'a>> {
    let mut parameters = Vec::new();
    let last = calls[calls.len() - 1];
    for (place, field) in last.fields.iter().enumerate() {
        let parameter = |field: &'a CallField, default, is_keyword| Parameter {
            field,
            name: field.snake(),
            default,
            is_keyword,
        };
        match &field.kind {
            FieldKind::Record(of) if of == "active events" => {
                let fields = table.record(of).fields();
                parameters.extend(fields.into_iter().map(|field| match field.kind {
                    FieldKind::Flag => parameter(field, Some("False"), true),
                    _ => parameter(field, Some("None"), true),
                }));
            }
            FieldKind::Choice(words) => parameters.push(Parameter {
                name: words[1][0].clone(),
                ..parameter(field, Some("False"), true)
            }),
            _ => {
                let is_extra = place >= calls[0].fields.len();
                let default = (is_extra || field.default.is_some()).then_some("None");
                parameters.push(parameter(field, default, false));
            }
        }
    }
    parameters
}

/// A method of a scene.
fn method(table: &Table, calls: &[&Call]) -> String {
    let first = calls[0];
    let parameters = parameters(table, calls);
    let mut declared: Vec<_> = parameters.iter().map(Parameter::declared).collect();
    let of_body = first.of == Owner::Body;
    if of_body {
        declared.insert(0, "body: &Bound<'_, PyAny>".to_owned());
    }
    let signature = match parameters
        .iter()
        .any(|parameter| parameter.default.is_some())
    {
        true => signature_of(&signature(of_body, &parameters)),
        false => String::new(),
    };
    let mut read = String::new();
    for parameter in &parameters {
        read += &reading(first, parameter);
    }
    let command = |call: &Call| made(call, &|field: &CallField| value(table, call, field));
    let made = match calls {
        [call] => command(call),
        [plain, extended] => {
            let extra = extended.fields[plain.fields.len()].snake();
            format!(
                "match &{extra} {{\nSome({extra}) => {},\nNone => {},\n}}",
                command(extended),
                command(plain)
            )
        }
        _ => panic!("three commands of one call"),
    };
    let each = match (made.contains("(coordinates)"), made.contains("[place]")) {
        (true, _) => "each_in(py, &ids, |id, coordinates|",
        (false, true) => "each(py, &ids, |id, place|",
        (false, false) => "each(py, &ids, |id, _|",
    };
    let (ids, send) = match of_body {
        true => (
            "let ids = bodies(body)?.ids;\n",
            format!("self.{each} {made})"),
        ),
        false => ("", format!("self.one(py, {made})")),
    };
    let docs = lines_of(calls, &parameters);
    let docs: String = docs
        .iter()
        .map(|line| format!("    /// {line}").trim_end().to_owned() + "\n")
        .collect();
    format!(
        "{docs}{signature}fn {}(&self, py: Python<'_>, {}) -> PyResult<Option<u64>> {{\n{ids}{read}{send}\n}}\n\n",
        first.call,
        declared.join(", ")
    )
}

/// The attribute with a signature, broken where it is long.
fn signature_of(signature: &str) -> String {
    match signature.len() > 85 {
        true => format!(
            "#[pyo3(signature = (\n        {},\n    ))]\n",
            wrapped(signature, 105).join("\n        ")
        ),
        false => format!("#[pyo3(signature = ({signature}))]\n"),
    }
}

/// Parameters, with the mark before those that have names alone.
fn listed<'a>(
    parameters: &'a [Parameter<'a>],
    written: impl Fn(&Parameter<'a>) -> String,
) -> Vec<String> {
    let mut parts = Vec::new();
    let mut is_keyword = false;
    for parameter in parameters {
        if parameter.is_keyword && !is_keyword {
            parts.push("*".to_owned());
            is_keyword = true;
        }
        parts.push(written(parameter));
    }
    parts
}

/// Parameters as Python's signatures have them.
fn signature(of_body: bool, parameters: &[Parameter<'_>]) -> String {
    let mut parts = Vec::new();
    if of_body {
        parts.push("body".to_owned());
    }
    parts.extend(listed(parameters, |parameter| match parameter.default {
        Some("False") => format!("{} = false", parameter.name),
        Some(default) => format!("{} = {default}", parameter.name),
        None => parameter.name.clone(),
    }));
    parts.join(", ")
}

/// The statement that reads a parameter.
fn reading(call: &Call, parameter: &Parameter<'_>) -> String {
    let of_body = call.of == Owner::Body;
    let name = &parameter.name;
    let is_extra = parameter.field.default.is_none();
    match (&parameter.field.kind, parameter.default) {
        (FieldKind::Vector, Some(_)) if is_extra => format!(
            "let {name} = {name}.map(|{name}| rows({name}, ids.len(), {name:?})).transpose()?;\n"
        ),
        (FieldKind::Vector, Some(_)) if !of_body => {
            format!(
                "let {name} = {name}.map_or(Ok(Vec3::ZERO), |{name}| vector({name}, {name:?}))?;\n"
            )
        }
        (FieldKind::Vector, Some(_)) => {
            format!("let {name} = optional_rows({name}, ids.len(), {name:?}, [0.0; 3])?;\n")
        }
        (FieldKind::Rotation, Some(_)) => {
            format!(
                "let {name} = optional_rows({name}, ids.len(), {name:?}, Quat::IDENTITY.to_array())?;\n"
            )
        }
        (FieldKind::Vector | FieldKind::Rotation, None) if of_body => {
            format!("let {name} = rows({name}, ids.len(), {name:?})?;\n")
        }
        (FieldKind::Vector, None) => format!("let {name} = vector({name}, {name:?})?;\n"),
        (FieldKind::Number, None) => format!("let {name} = real({name}, {name:?})?;\n"),
        (FieldKind::Number, Some(_)) => {
            let default = parameter.field.default.as_deref();
            let otherwise = default.map(|default| format!(".unwrap_or({:?})", default[0]));
            let otherwise = otherwise.unwrap_or_default();
            format!("let {name} = optional_real({name}, {name:?})?{otherwise};\n")
        }
        (FieldKind::Choice(words), _) => {
            let kind = choice_name(call, parameter.field);
            let [no, yes] = [&words[0][0], &words[1][0]].map(|word| pascal(word));
            format!(
                "let {} = match {name} {{\ntrue => {kind}::{yes},\nfalse => {kind}::{no},\n}};\n",
                parameter.field.snake()
            )
        }
        _ => String::new(),
    }
}

/// The value of a field in a command.
fn value(table: &Table, call: &Call, field: &CallField) -> String {
    let name = field.snake();
    match &field.kind {
        FieldKind::Vector if call.of == Owner::Body => format!("Vec3::from_array({name}[place])"),
        FieldKind::Rotation => format!("Quat::from_array({name}[place])"),
        FieldKind::Record(of) if of == "active events" => {
            let fields: Vec<_> = table
                .record(of)
                .fields()
                .into_iter()
                .map(CallField::snake)
                .collect();
            format!("ActiveEvents {{ {} }}", fields.join(", "))
        }
        FieldKind::Record(of) => format!("{name}.get().{}(coordinates)", snake(of)),
        FieldKind::List { of, .. } => {
            let one = name.trim_end_matches('s');
            format!(
                "{name}.iter().map(|{one}| {one}.{}(coordinates)).collect()",
                snake(of)
            )
        }
        _ => name,
    }
}

/// The documentation of a method.
fn lines_of(calls: &[&Call], parameters: &[Parameter<'_>]) -> Vec<String> {
    let doc = match calls {
        [call] => call.doc.clone(),
        [plain, extended] => {
            let extra = extended.fields[plain.fields.len()].snake();
            format!("{} With a {extra}, it acts there.", plain.doc)
        }
        _ => panic!("three commands of one call"),
    };
    let mut lines = summary(&doc);
    let meanings: Vec<_> = parameters.iter().filter_map(Parameter::meaning).collect();
    if !meanings.is_empty() {
        lines.push(String::new());
    }
    for meaning in meanings {
        lines.extend(wrapped(&meaning, 108));
    }
    lines
}

/// A first sentence of its own, and the rest.
fn summary(doc: &str) -> Vec<String> {
    let (first, rest) = doc
        .split_once(". ")
        .map_or((doc, ""), |(first, rest)| (first, rest));
    let first = if rest.is_empty() {
        first.to_owned()
    } else {
        format!("{first}.")
    };
    let mut lines = wrapped(&first, 105);
    if !rest.is_empty() {
        lines.push(String::new());
        lines.extend(wrapped(rest, 108));
    }
    lines
}

/// Lines as a docstring.
fn docstring(indent: &str, lines: &[String]) -> String {
    let body = lines
        .join(&format!("\n{indent}"))
        .replace(&format!("\n{indent}\n"), "\n\n");
    match lines.iter().any(String::is_empty) {
        true => format!("{indent}\"\"\"{body}\n{indent}\"\"\"\n"),
        false => format!("{indent}\"\"\"{body}\"\"\"\n"),
    }
}

/// A head that is too long, with a parameter on each line.
fn broken(head: &str) -> String {
    if head.chars().count() <= 121 {
        return head.to_owned();
    }
    let (name, rest) = head.split_once('(').expect("parameters");
    let (parameters, result) = rest.rsplit_once(')').expect("parameters");
    let mut depth = 0;
    let mut lines = String::new();
    for letter in parameters.chars() {
        match letter {
            '[' => depth += 1,
            ']' => depth -= 1,
            _ => {}
        }
        match letter {
            ',' if depth == 0 => lines += ",\n       ",
            _ => lines.push(letter),
        }
    }
    format!("{name}(\n        {lines},\n    ){result}")
}

/// The members of a record, those that it needs first.
fn in_order(record: &ValueRecord) -> Vec<&RecordMember> {
    let is_needed = |member: &&RecordMember| matches!(member, RecordMember::Plain(field) if record.needs(field));
    let (needed, others): (Vec<_>, Vec<_>) = record.members.iter().partition(is_needed);
    [needed, others].concat()
}

/// A parameter of the constructor of a class: its name, its type in a stub, and whether it may be left out.
fn arguments(record: &ValueRecord) -> Vec<(String, String, bool)> {
    let mut arguments = Vec::new();
    for member in in_order(record) {
        match member {
            RecordMember::Plain(field) | RecordMember::Optional(field) => {
                let kind = if field.kind == FieldKind::Vector {
                    "_Vector"
                } else {
                    "float"
                };
                arguments.push((field.snake(), kind.to_owned(), !record.needs(field)));
            }
            RecordMember::Group(group, fields) => {
                let (flags, numbers): (Vec<_>, Vec<_>) = fields
                    .iter()
                    .partition(|field| field.kind == FieldKind::Flag);
                let each = vec!["float"; numbers.len()].join(", ");
                arguments.push((group.clone(), format!("Tuple[{each}]"), true));
                arguments.extend(
                    flags
                        .iter()
                        .map(|flag| (flag.snake(), "bool".to_owned(), true)),
                );
            }
        }
    }
    arguments
}

/// The documentation of a class: what it is, and each of its parameters.
fn lines_of_class(record: &ValueRecord) -> Vec<String> {
    let mut lines = summary(&record.doc);
    lines.push(String::new());
    for member in in_order(record) {
        let line = match member {
            RecordMember::Plain(field) => of_field(&field.snake(), field),
            RecordMember::Optional(field) if field.default.is_some() => {
                of_field(&field.snake(), field)
                    .trim_end_matches('.')
                    .to_owned()
                    + "; 0 for none."
            }
            RecordMember::Optional(field) => of_field(&field.snake(), field),
            RecordMember::Group(group, fields) => {
                let (flags, numbers): (Vec<_>, Vec<_>) = fields
                    .iter()
                    .partition(|field| field.kind == FieldKind::Flag);
                let numbers: Vec<_> = numbers
                    .iter()
                    .map(|field| meaning(field, Lengths::OfScene))
                    .collect();
                let own = format!("{group}: {}; None for none.", numbers.join(", and "));
                lines.extend(wrapped(&own, 108));
                let flags: Vec<_> = flags
                    .iter()
                    .map(|flag| of_field(&flag.snake(), flag))
                    .collect();
                flags.join("\n")
            }
        };
        lines.extend(line.split('\n').flat_map(|line| wrapped(line, 108)));
    }
    lines
}

fn of_field(name: &str, field: &CallField) -> String {
    let default = match (field.default.as_deref(), field.unit.as_deref()) {
        (Some(&[0.0]), _) | (None, _) => String::new(),
        (Some(&[most]), _) if Some(most) == field.bounds[1] => "; any by default".to_owned(),
        (Some(&[value]), Some(unit)) => format!(
            "; {} {} by default",
            number(value),
            crate::table::symbol(unit)
        ),
        (Some(&[value]), None) => format!("; {} by default", number(value)),
        (Some(&[0.0, -1.0, 0.0]), _) => "; down by default".to_owned(),
        (Some(_), _) => "; along x by default, in Unreal's coordinates along y".to_owned(),
    };
    format!("{name}: {}{default}.", meaning(field, Lengths::OfScene))
}

fn stub_of_class(record: &ValueRecord) -> String {
    let name = pascal(&record.name);
    let mut parts = vec!["self".to_owned()];
    let mut is_keyword = record.is_zero();
    for (argument, kind, may_lack) in arguments(record) {
        if may_lack && !is_keyword {
            parts.push("*".to_owned());
            is_keyword = true;
        }
        parts.push(match (kind.as_str(), may_lack) {
            ("bool", _) => format!("{argument}: bool = False"),
            ("float", true) if record.is_zero() => format!("{argument}: float = 0.0"),
            (_, true) => format!("{argument}: Optional[{kind}] = None"),
            (_, false) => format!("{argument}: {kind}"),
        });
    }
    let head = broken(&format!(
        "    def __init__({}) -> None: ...\n",
        parts.join(", ")
    ));
    format!(
        "@final\nclass {name}:\n{}\n{head}\n",
        docstring("    ", &lines_of_class(record))
    )
}

/// A class.
fn class(table: &Table, record: &ValueRecord) -> String {
    let (name, own) = (pascal(&record.name), snake(&record.name));
    let doc: String = lines_of_class(record)
        .iter()
        .map(|line| format!("/// {line}").trim_end().to_owned() + "\n")
        .collect();
    let mut parts = ClassParts::default();
    for member in in_order(record) {
        parts.add(record, member, &name);
    }
    let needed: Vec<_> = record
        .fields()
        .into_iter()
        .filter(|field| record.needs(field))
        .collect();
    let needed: Vec<_> = needed
        .iter()
        .map(|field| format!("self.{}", field.snake()))
        .collect();
    let plain_of = match record.is_zero() {
        true => String::new(),
        false => format!(
            "let plain = coordinates.plain_{own}({});\n",
            needed.join(", ")
        ),
    };
    let user = plain(table, record);
    let checked = made(user, &|field: &CallField| match field.kind {
        FieldKind::List { .. } => format!("vec![{own}]"),
        _ => own.clone(),
    });
    let coordinates = if record.is_zero() {
        "_coordinates"
    } else {
        "coordinates"
    };
    let signature = signature_of(&class_signature(record));
    let expected = match arguments(record).len() > 6 {
        true => {
            "    // Named parameters are the interface of Python.\n    #[expect(clippy::too_many_arguments)]\n"
        }
        false => "",
    };
    fill(
        CLASS,
        &[
            ("doc", &doc),
            ("name", &name),
            ("own", &own),
            ("fields", &parts.fields),
            ("coordinates", coordinates),
            ("plain", &plain_of),
            ("values", &parts.values),
            ("signature", &signature),
            ("expected", expected),
            ("parameters", &parts.parameters),
            ("read", &parts.read),
            ("checked", &checked),
            ("shown", &parts.shown),
        ],
    )
}

const CLASS: &str = "\
@doc@#[pyclass(frozen, name = \"@name@\", module = \"rhumb\")]
#[derive(Debug)]
pub(crate) struct Py@name@ {
@fields@}

impl Py@name@ {
    pub(crate) fn @own@(&self, @coordinates@: Coordinates) -> @name@ {
        @plain@@name@ {
@values@        }
    }
}

#[pymethods]
impl Py@name@ {
    #[new]
    @signature@@expected@    fn new(py: Python<'_>, @parameters@) -> PyResult<Self> {
        let made = Self {
@read@        };
        check_in_any(py, |coordinates| {
            let @own@ = coordinates.@own@_in(made.@own@(coordinates));
            let id = BodyId::new(0, 0);
            @checked@.check()
        })?;
        Ok(made)
    }

    fn __repr__(&self) -> String {
        call(\"@name@\", &[@shown@])
    }
}

";

fn class_signature(record: &ValueRecord) -> String {
    let mut parts = Vec::new();
    let mut is_keyword = record.is_zero();
    for (argument, kind, may_lack) in arguments(record) {
        if may_lack && !is_keyword {
            parts.push("*".to_owned());
            is_keyword = true;
        }
        parts.push(match (kind.as_str(), may_lack) {
            ("bool", _) => format!("{argument} = false"),
            (_, true) => format!("{argument} = None"),
            _ => argument,
        });
    }
    parts.join(", ")
}

/// The members of a record, written as the parts of a class.
#[derive(Default)]
struct ClassParts {
    fields: String,
    values: String,
    parameters: String,
    read: String,
    shown: String,
}

impl ClassParts {
    fn add(&mut self, record: &ValueRecord, member: &RecordMember, class: &str) {
        match member {
            RecordMember::Plain(field) if record.needs(field) => self.add_needed(field),
            RecordMember::Plain(field) if record.is_zero() => self.add_zero(field),
            RecordMember::Plain(field) => {
                let name = field.snake();
                self.add_optional(
                    field,
                    format!("{name}: self.{name}.unwrap_or(plain.{name}),\n"),
                );
            }
            RecordMember::Optional(field) if field.default.is_some() => {
                let name = field.snake();
                self.add_optional(
                    field,
                    format!("{name}: self.{name}.map_or(plain.{name}, |{name}| ({name} != 0.0).then_some({name})),\n"),
                );
            }
            RecordMember::Optional(field) => {
                let name = field.snake();
                self.add_optional(field, format!("{name}: self.{name},\n"));
            }
            RecordMember::Group(group, fields) => self.add_group(group, fields, class),
        }
    }

    fn add_needed(&mut self, field: &CallField) {
        let name = field.snake();
        let (kind, read, shown) = match field.kind {
            FieldKind::Vector => ("Vec3", "vector", "triple"),
            _ => ("f32", "real", "number"),
        };
        self.fields += &format!("{name}: {kind},\n");
        self.values += &format!("{name}: self.{name},\n");
        self.parameters += &format!("{name}: &Bound<'_, PyAny>,\n");
        self.read += &format!("{name}: {read}({name}, {name:?})?,\n");
        self.shown += &format!("({name:?}, Some({shown}(self.{name}))),\n");
    }

    fn add_zero(&mut self, field: &CallField) {
        let name = field.snake();
        self.fields += &format!("{name}: f32,\n");
        self.values += &format!("{name}: self.{name},\n");
        self.parameters += &format!("{name}: Option<&Bound<'_, PyAny>>,\n");
        self.read += &format!("{name}: optional_real({name}, {name:?})?.unwrap_or_default(),\n");
        self.shown += &format!("({name:?}, Some(number(self.{name}))),\n");
    }

    fn add_optional(&mut self, field: &CallField, value: String) {
        let name = field.snake();
        let (kind, read, shown) = match field.kind {
            FieldKind::Vector => (
                "Vec3",
                format!("{name}.map(|{name}| vector({name}, {name:?})).transpose()?"),
                "triple",
            ),
            _ => ("f32", format!("optional_real({name}, {name:?})?"), "number"),
        };
        self.fields += &format!("{name}: Option<{kind}>,\n");
        self.values += &value;
        self.parameters += &format!("{name}: Option<&Bound<'_, PyAny>>,\n");
        self.read += &format!("{name}: {read},\n");
        self.shown += &format!("({name:?}, self.{name}.map({shown})),\n");
    }

    fn add_group(&mut self, group: &str, fields: &[CallField], class: &str) {
        let kind = format!("{class}{}", pascal(group));
        let (flags, numbers): (Vec<_>, Vec<_>) = fields
            .iter()
            .partition(|field| field.kind == FieldKind::Flag);
        let own = |fields: &[&CallField]| {
            fields
                .iter()
                .map(|field| field.within(group))
                .collect::<Vec<_>>()
        };
        let (flags, numbers) = (own(&flags), own(&numbers));
        self.fields += &format!("{group}: Option<{kind}>,\n");
        self.values += &format!("{group}: self.{group},\n");
        self.parameters += &format!("{group}: Option<&Bound<'_, PyAny>>,\n");
        let each = [numbers.as_slice(), flags.as_slice()].concat().join(", ");
        self.read += &format!(
            "{group}: {group}.map(|{group}| {{\nlet [{}] = reals({group}, {group:?})?;\nOk::<_, PyErr>({kind} {{ {each} }})\n}}).transpose()?,\n",
            numbers.join(", ")
        );
        let places = vec!["{}"; numbers.len()].join(", ");
        let values: Vec<_> = numbers
            .iter()
            .map(|name| format!("{group}.{name}"))
            .collect();
        self.shown += &format!(
            "({group:?}, self.{group}.map(|{group}| format!(\"({places})\", {}))),\n",
            values.join(", ")
        );
        for flag in &flags {
            self.parameters += &format!("{flag}: bool,\n");
            self.shown += &format!(
                "({flag:?}, self.{group}.and_then(|{group}| {group}.{flag}.then(|| \"True\".to_owned()))),\n"
            );
        }
    }
}
