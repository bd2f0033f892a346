//! Objects of JSON whose absent fields are left out.
//!
//! JavaScript reads an absent field as `undefined`, and `rhumb.d.ts` says so. Null would pass as the number zero.

use serde_json::{Map, Value};

/// An object, written as in `json!`, without the fields that are null.
macro_rules! object {
    ({$($name:literal: $value:expr),* $(,)?}) => {
        $crate::object::of_fields(vec![$(($name, serde_json::Value::from($value))),*])
    };
}
pub(crate) use object;

/// An object of these fields without those that are null.
pub(crate) fn of_fields(fields: Vec<(&str, Value)>) -> Value {
    let mut object = Map::new();
    for (name, value) in fields {
        if !value.is_null() {
            object.insert(name.to_owned(), value);
        }
    }
    Value::Object(object)
}
