//! Commands as expressions of Rust.

use crate::table::{Call, CallField, FieldKind, Owner, Table, ValueRecord};
use crate::text::pascal;

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
