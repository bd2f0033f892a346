//! Decodes control messages by `spec/tables/protocol.json` only.
//!
//! It is independent of the codec; other code compares the two. A decoded value is JSON: fields by name, `is` for the
//! variant, f32s and u64s as the hexadecimal digits of their bits, bytes as hexadecimal digits.

use std::collections::BTreeMap;

use serde_json::{Map, Value, json};

/// The table of messages.
#[derive(Debug)]
pub struct Grammar {
    table: Value,
}

/// The position of one number in a message, and its constraints in the table.
#[derive(Clone, Debug)]
pub struct Span {
    /// The names of the fields that lead to it, separated by dots.
    pub path: String,
    /// Its primitive type, or `code`.
    pub kind: String,
    /// First byte.
    pub start: usize,
    /// One past its last byte.
    pub end: usize,
    /// Least and greatest value, if the table bounds it.
    pub bounds: (Option<u64>, Option<u64>),
    /// The forbidden value, as bytes.
    pub not: Option<Vec<u8>>,
    /// Least and greatest number that a server takes, if the table has both by name or value.
    pub within: Option<[f32; 2]>,
}

/// The reason why bytes do not match the table.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Unreadable(pub String);

impl Grammar {
    /// The table of this repository.
    ///
    /// # Panics
    ///
    /// When it is not JSON.
    #[must_use]
    pub fn load() -> Self {
        let text = include_str!("../spec/tables/protocol.json");
        let table = serde_json::from_str(text).expect("the table is JSON");
        Self { table }
    }

    /// The whole table.
    #[must_use]
    pub const fn table(&self) -> &Value {
        &self.table
    }

    /// The limits by name.
    ///
    /// # Panics
    ///
    /// When the table has none.
    #[must_use]
    pub fn limits(&self) -> BTreeMap<&str, f64> {
        let limits = self.table["limits"]
            .as_object()
            .expect("an object of limits");
        let number = |value: &Value| value.as_f64().expect("a limit is a number");
        limits
            .iter()
            .map(|(name, value)| (name.as_str(), number(value)))
            .collect()
    }

    /// Decodes bytes as one whole value of a type; also returns the position of each number.
    ///
    /// # Errors
    ///
    /// [`Unreadable`] when they do not match the table.
    pub fn read(&self, name: &str, bytes: &[u8]) -> Result<(Value, Vec<Span>), Unreadable> {
        let mut reading = Reading {
            grammar: self,
            bytes,
            at: 0,
            path: Vec::new(),
            spans: Vec::new(),
        };
        let value = reading.named(name, &json!({}))?;
        if reading.at < bytes.len() {
            return Err(Unreadable(format!(
                "{} trailing bytes",
                bytes.len() - reading.at
            )));
        }
        Ok((value, reading.spans))
    }

    /// The bounds of a quantity: `to` alone bounds its size.
    fn within(&self, field: &Value) -> Option<[f32; 2]> {
        let of = |bound: &Value| match bound {
            Value::String(name) => self.table["limits"][name.as_str()].as_f64(),
            other => other.as_f64(),
        };
        let most = of(&field["to"])?;
        let least = of(&field["from"]).unwrap_or(-most);
        Some([least as f32, most as f32])
    }

    fn bound(&self, bound: &Value) -> Option<u64> {
        match bound {
            Value::String(name) => self.table["limits"][name.as_str()].as_u64(),
            other => other.as_u64(),
        }
    }
}

struct Reading<'a> {
    grammar: &'a Grammar,
    bytes: &'a [u8],
    at: usize,
    path: Vec<String>,
    spans: Vec<Span>,
}

impl Reading<'_> {
    fn fail<T>(&self, why: &str) -> Result<T, Unreadable> {
        Err(Unreadable(format!(
            "{} at {}: {why}",
            self.path.join("."),
            self.at
        )))
    }

    fn take(&mut self, count: usize) -> Result<&[u8], Unreadable> {
        if self.bytes.len() - self.at < count {
            return self.fail("ends too early");
        }
        self.at += count;
        Ok(&self.bytes[self.at - count..self.at])
    }

    /// Decodes a value of a named type, or of a primitive that `field` bounds.
    fn named(&mut self, name: &str, field: &Value) -> Result<Value, Unreadable> {
        let grammar = self.grammar;
        let Some(definition) = grammar.table["types"].get(name) else {
            return self.primitive(name, field);
        };
        if let Some(fields) = definition.get("fields") {
            return self.fields(fields).map(Value::Object);
        }
        if definition.get("times").is_some() {
            return self.times(definition);
        }
        match definition["is"].as_str() {
            Some(primitive) => self.primitive(primitive, definition),
            None => self.coded(definition, field),
        }
    }

    fn coded(&mut self, definition: &Value, field: &Value) -> Result<Value, Unreadable> {
        let start = self.at;
        let code = u64::from(self.take(1)?[0]);
        self.note("code", start, (None, None), None);
        let codes = definition["codes"].as_array().expect("codes are listed");
        let excepted = field["except"].as_array();
        if excepted.is_some_and(|excepted| excepted.iter().any(|other| *other == code)) {
            return self.fail("a code that is not allowed here");
        }
        if let Some(row) = codes.iter().find(|row| row["code"] == code) {
            let mut sent = Map::new();
            sent.insert("is".to_owned(), row["name"].clone());
            sent.extend(self.fields(&row["fields"])?);
            return Ok(Value::Object(sent));
        }
        let optional = definition["optional"].as_u64();
        if optional.is_some_and(|optional| code >= optional) {
            let rest = hex(self.take(self.bytes.len() - self.at)?);
            return Ok(json!({"is": code, "rest": rest}));
        }
        self.fail("unknown code")
    }

    fn fields(&mut self, fields: &Value) -> Result<Map<String, Value>, Unreadable> {
        let mut sent = Map::new();
        for field in fields.as_array().expect("fields are listed") {
            let name = field["name"].as_str().expect("a field has a name");
            if !is_there(field, &sent) {
                continue;
            }
            self.path.push(name.to_owned());
            let value = match field["type"].as_str() {
                Some(kind) => self.named(kind, field)?,
                None if field.get("each").is_some() => self.each(field, &sent)?,
                None => self.times(field)?,
            };
            if let Some(factors) = field["product"].as_array() {
                let most = self.grammar.bound(&factors[1]);
                let product = value
                    .as_u64()
                    .zip(sent[factors[0].as_str().unwrap_or_default()].as_u64());
                let product = product.and_then(|(one, other)| one.checked_mul(other));
                if product.is_none() || product > most {
                    return self.fail("product out of range");
                }
            }
            self.path.pop();
            sent.insert(name.to_owned(), value);
        }
        Ok(sent)
    }

    fn times(&mut self, field: &Value) -> Result<Value, Unreadable> {
        let times = &field["times"];
        let kind = times[0].as_str().expect("a repeated field has a type");
        let bounds = json!({"least": times[1], "most": times[2]});
        let counted_by = field["counted by"].as_str().unwrap_or("varint");
        self.path.push("count".to_owned());
        let count = self.primitive(counted_by, &bounds)?;
        self.path.pop();
        self.repeated(kind, count.as_u64().unwrap_or_default())
    }

    /// Decodes a repeated field whose count is the product of earlier fields.
    fn each(&mut self, field: &Value, sent: &Map<String, Value>) -> Result<Value, Unreadable> {
        let each = field["each"].as_array().expect("a type and names");
        let mut names = each.iter().map(|name| name.as_str().unwrap_or_default());
        let kind = names.next().expect("a repeated field has a type");
        let count = names.map(|name| sent[name].as_u64().unwrap_or_default());
        self.repeated(kind, count.product())
    }

    fn repeated(&mut self, kind: &str, count: u64) -> Result<Value, Unreadable> {
        let mut values = Vec::new();
        for place in 0..count {
            self.path.push(place.to_string());
            values.push(self.named(kind, &json!({}))?);
            self.path.pop();
        }
        Ok(Value::Array(values))
    }

    fn primitive(&mut self, kind: &str, field: &Value) -> Result<Value, Unreadable> {
        let bounds = (
            self.grammar.bound(&field["least"]),
            self.grammar.bound(&field["most"]),
        );
        let start = self.at;
        let value = match kind {
            "u8" | "u16" | "u32" | "u64" => {
                let size = kind[1..].parse::<usize>().unwrap_or_default() / 8;
                let bytes = self.take(size)?;
                let number = bytes.iter().rev().fold(0, |n, b| n << 8 | u64::from(*b));
                let value = self.bounded(number, bounds, field)?;
                if kind == "u64" {
                    Value::String(format!("{number:016x}"))
                } else {
                    value
                }
            }
            "i8" => {
                let number = i64::from(self.take(1)?[0].cast_signed());
                let bounds = [&field["least"], &field["most"]].map(Value::as_i64);
                if bounds[0].is_some_and(|least| number < least)
                    || bounds[1].is_some_and(|most| number > most)
                {
                    return self.fail("out of range");
                }
                Value::from(number)
            }
            "varint" => {
                let number = self.varint()?;
                self.bounded(number, bounds, field)?
            }
            "varint32" | "count" => {
                let natural = if kind == "count" {
                    1 << 48
                } else {
                    0xffff_ffff
                };
                let number = self.varint()?;
                let bounds = (bounds.0, Some(bounds.1.unwrap_or(natural)));
                let value = self.bounded(number, bounds, field)?;
                self.note(kind, start, bounds, None);
                return Ok(value);
            }
            "f32" => self.f32()?,
            "vec3" => Value::Array((0..3).map(|_| self.f32()).collect::<Result<_, _>>()?),
            "quat" => Value::Array((0..4).map(|_| self.f32()).collect::<Result<_, _>>()?),
            "bytes" => {
                let left = self.bytes.len() - self.at;
                self.bounded(left as u64, bounds, field)?;
                Value::String(hex(self.take(left)?))
            }
            "sized" | "text" => return self.sized(kind, bounds, field),
            _ => return self.fail("unknown type"),
        };
        let not = field["not"].as_str().map(unhex);
        if not.as_deref() == Some(&self.bytes[start..self.at]) {
            return self.fail("must be left out");
        }
        self.note(kind, start, bounds, not);
        if let Some(span) = self.spans.last_mut() {
            span.within = self.grammar.within(field);
        }
        Ok(value)
    }

    fn sized(
        &mut self,
        kind: &str,
        bounds: (Option<u64>, Option<u64>),
        field: &Value,
    ) -> Result<Value, Unreadable> {
        let start = self.at;
        let length = self.varint()?;
        self.bounded(length, bounds, field)?;
        self.note("length", start, bounds, None);
        let bytes = self
            .take(usize::try_from(length).unwrap_or(usize::MAX))?
            .to_vec();
        if kind == "sized" {
            return Ok(Value::String(hex(&bytes)));
        }
        let allowed = |c: &u8| c.is_ascii_alphanumeric() || b"-_./".contains(c);
        match String::from_utf8(bytes) {
            Ok(text) if text.as_bytes().iter().all(allowed) => Ok(Value::String(text)),
            _ => self.fail("invalid character in a name"),
        }
    }

    fn f32(&mut self) -> Result<Value, Unreadable> {
        let bytes: Vec<u8> = self.take(4)?.iter().rev().copied().collect();
        Ok(Value::String(hex(&bytes)))
    }

    fn varint(&mut self) -> Result<u64, Unreadable> {
        let mut number = 0_u128;
        for place in 0..10 {
            let byte = self.take(1)?[0];
            number |= u128::from(byte & 0x7f) << (7 * place);
            if byte < 0x80 {
                if byte == 0 && place > 0 {
                    return self.fail("not the shortest form");
                }
                return u64::try_from(number).or_else(|_| self.fail("more than 64 bits"));
            }
        }
        self.fail("more than ten bytes")
    }

    fn bounded(
        &self,
        number: u64,
        (least, most): (Option<u64>, Option<u64>),
        field: &Value,
    ) -> Result<Value, Unreadable> {
        let within = least.is_none_or(|least| number >= least)
            && most.is_none_or(|most| number <= most)
            && field["mask"]
                .as_u64()
                .is_none_or(|mask| number & !mask == 0);
        let kind = field["kinds"]
            .as_array()
            .and_then(|pair| Some((pair.first()?.as_u64()?, pair.get(1)?.as_u64()?)));
        if within && kind.is_none_or(|(mask, most)| number & mask <= most) {
            Ok(Value::from(number))
        } else {
            self.fail("out of range")
        }
    }

    fn note(
        &mut self,
        kind: &str,
        start: usize,
        bounds: (Option<u64>, Option<u64>),
        not: Option<Vec<u8>>,
    ) {
        self.spans.push(Span {
            path: self.path.join("."),
            kind: kind.to_owned(),
            start,
            end: self.at,
            bounds,
            not,
            within: None,
        });
    }
}

/// True if an optional field is present, given the earlier fields.
fn is_there(field: &Value, sent: &Map<String, Value>) -> bool {
    let Some(when) = field["when"].as_array() else {
        return true;
    };
    let mut names = when[0].as_str().unwrap_or_default().split('.');
    let first = names.next().and_then(|name| sent.get(name));
    let flags = names.fold(first, |value, name| value?.get(name));
    let flags = flags.and_then(Value::as_u64).unwrap_or_default();
    Some(flags & when[1].as_u64().unwrap_or_default()) == when[2].as_u64()
}

/// Bytes as hexadecimal digits.
#[must_use]
pub fn hex(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 16] = b"0123456789abcdef";
    let mut digits = Vec::with_capacity(2 * bytes.len());
    for byte in bytes {
        let (high, low) = (usize::from(byte >> 4), usize::from(byte & 15));
        digits.extend_from_slice(&[DIGITS[high], DIGITS[low]]);
    }
    String::from_utf8(digits).expect("digits are text")
}

/// Bytes from hexadecimal digits.
///
/// # Panics
///
/// When the text contains other characters.
#[must_use]
pub fn unhex(text: &str) -> Vec<u8> {
    let digits: Vec<_> = text.bytes().filter(|byte| *byte != b' ').collect();
    let pairs = digits.chunks(2).map(|pair| {
        let pair = std::str::from_utf8(pair).expect("ASCII digits");
        u8::from_str_radix(pair, 16).expect("hexadecimal digits")
    });
    pairs.collect()
}
