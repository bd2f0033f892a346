//! Objects of JSON whose absent fields are left out.
//!
//! JavaScript reads an absent field as `undefined`, and `rhumb.d.ts` says so. Null would pass as the number zero.

use serde_json::{Map, Value};

/// An object, written as in `json!`, without the fields that are null.
macro_rules! object {
    ({$($name:literal: $value:expr),* $(,)?}) => {{
        let mut object = serde_json::Map::new();
        $($crate::object::set(&mut object, $name, $value);)*
        serde_json::Value::Object(object)
    }};
}
pub(crate) use object;

/// Sets a field, but for one that is null. Inlined into each field of each object, it makes the module 2 % larger.
#[inline(never)]
pub(crate) fn set(object: &mut Map<String, Value>, name: &str, value: impl Into<Value>) {
    let value = value.into();
    if !value.is_null() {
        object.insert(name.to_owned(), value);
    }
}
