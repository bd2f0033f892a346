//! The compiled schema embedded in traces matches its source.

use std::collections::BTreeMap;

use prost::Message;
use prost_types::{DescriptorProto, EnumDescriptorProto, FileDescriptorSet};

const SOURCE: &str = include_str!("../proto/rhumb.proto");
const COMPILED: &[u8] = include_bytes!("../proto/rhumb.binpb");

/// Names and numbers of the fields of each message and the values of each enumeration.
type Named = BTreeMap<String, Vec<(String, i32)>>;

fn from_source() -> Named {
    let mut named = Named::new();
    let mut inside = String::new();
    for line in SOURCE
        .lines()
        .map(str::trim)
        .filter(|line| !line.starts_with("//"))
    {
        let words: Vec<_> = line.trim_end_matches(';').split_whitespace().collect();
        match words.as_slice() {
            ["message" | "enum", name, "{"] => inside = (*name).to_owned(),
            [.., name, "=", number] if !inside.is_empty() => {
                let number = number.parse().expect("a field has a number");
                named
                    .entry(inside.clone())
                    .or_default()
                    .push(((*name).to_owned(), number));
            }
            _ => {}
        }
    }
    named
}

fn from_compiled() -> Named {
    let mut set = FileDescriptorSet::decode(COMPILED).expect("protoc output is valid");
    assert_eq!(set.file.len(), 1);
    let file = set.file.remove(0);
    assert_eq!(file.package(), "rhumb");
    let fields = |message: &DescriptorProto| {
        let fields = message
            .field
            .iter()
            .map(|field| (field.name().to_owned(), field.number()));
        (message.name().to_owned(), fields.collect())
    };
    let values = |list: &EnumDescriptorProto| {
        let values = list
            .value
            .iter()
            .map(|value| (value.name().to_owned(), value.number()));
        (list.name().to_owned(), values.collect())
    };
    let messages = file.message_type.iter().map(fields);
    messages.chain(file.enum_type.iter().map(values)).collect()
}

#[test]
fn the_compiled_schema_matches_its_source() {
    let source = from_source();
    assert!(source.len() > 5 && source["States"].len() == 27);
    assert_eq!(source, from_compiled());
}
