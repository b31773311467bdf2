//! A JSON value as landmark files need it: names in their order, duplicates, and whether a number was written as a whole one.

use std::fmt;
use std::path::Path;

use serde::de::{Deserialize, Deserializer, MapAccess, SeqAccess, Visitor};

use super::{Place, ReadError};
use crate::io::without_mark;
use crate::mesh::Vec3;

pub(super) enum Json {
    Number { value: f64, integer: bool },
    Text(String),
    Array(Vec<Json>),
    Object(Vec<(String, Json)>),
    Null,
    Bool,
}

impl Json {
    pub(super) fn parse(bytes: &[u8], path: &Path) -> Result<Self, ReadError> {
        serde_json::from_slice(without_mark(bytes)).map_err(|error| {
            let place = if error.line() == 0 { Place::File } else { Place::Line(error.line()) };
            ReadError::json(path, place, "JSON", &error)
        })
    }

    /// What it is, for a message.
    pub(super) fn kind(&self) -> String {
        match self {
            Self::Number { value, .. } => value.to_string(),
            Self::Array(items) => {
                let shown: Vec<String> = items.iter().take(4).map(Self::kind).collect();
                format!("[{}{}]", shown.join(", "), if items.len() > 4 { ", ..." } else { "" })
            }
            Self::Object(_) => "an object".to_owned(),
            Self::Text(_) => "a string".to_owned(),
            Self::Null => "null".to_owned(),
            Self::Bool => "true or false".to_owned(),
        }
    }

    /// The first value of that name in an object.
    pub(super) fn get(&self, key: &str) -> Option<&Self> {
        let Self::Object(entries) = self else { return None };
        entries.iter().find(|(name, _)| name == key).map(|(_, value)| value)
    }

    pub(super) fn text(&self) -> Option<&str> {
        if let Self::Text(text) = self { Some(text) } else { None }
    }

    pub(super) fn number(&self) -> Option<f64> {
        if let Self::Number { value, .. } = self { Some(*value) } else { None }
    }

    pub(super) fn array(&self) -> Option<&[Self]> {
        if let Self::Array(items) = self { Some(items) } else { None }
    }

    /// A number written as a whole one.
    pub(super) fn whole(&self) -> Option<f64> {
        if let Self::Number { value, integer: true } = self { Some(*value) } else { None }
    }

    /// Three numbers.
    pub(super) fn triple(&self) -> Option<[f64; 3]> {
        let [x, y, z] = self.array()? else { return None };
        Some([x.number()?, y.number()?, z.number()?])
    }

    /// `[triangle, u, v]`.
    pub(super) fn surface_point(&self) -> Option<[f64; 3]> {
        let [triangle, u, v] = self.triple()?;
        let whole = self.array()?.first()?.whole().is_some();
        (whole && triangle >= 0.0 && u >= 0.0 && v >= 0.0 && u + v <= 1.0 + 1e-6).then_some([triangle, u, v])
    }

    /// `[x, y, z]`.
    pub(super) fn point(&self, path: &Path, name: &str, expected: &str) -> Result<Vec3, ReadError> {
        let point = Vec3::from(self.triple().ok_or_else(|| wrong_entry(path, name, expected, self.kind()))?);
        if point.iter().all(|c| c.is_finite()) {
            return Ok(point);
        }
        Err(wrong_entry(path, name, "finite coordinates", self.kind()))
    }
}

/// What landmark `name` has is not `expected`.
pub(super) fn wrong_entry(path: &Path, name: &str, expected: &str, found: impl Into<String>) -> ReadError {
    ReadError::malformed(path, Place::File, format!("{expected} for landmark {name:?}"), found)
}

impl<'de> Deserialize<'de> for Json {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct JsonVisitor;
        impl<'de> Visitor<'de> for JsonVisitor {
            type Value = Json;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a JSON value")
            }
            fn visit_u64<E>(self, value: u64) -> Result<Json, E> {
                Ok(Json::Number { value: value as f64, integer: true })
            }
            fn visit_i64<E>(self, value: i64) -> Result<Json, E> {
                Ok(Json::Number { value: value as f64, integer: true })
            }
            fn visit_f64<E>(self, value: f64) -> Result<Json, E> {
                Ok(Json::Number { value, integer: false })
            }
            fn visit_bool<E>(self, _: bool) -> Result<Json, E> {
                Ok(Json::Bool)
            }
            fn visit_unit<E>(self) -> Result<Json, E> {
                Ok(Json::Null)
            }
            fn visit_str<E>(self, text: &str) -> Result<Json, E> {
                Ok(Json::Text(text.to_owned()))
            }
            fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Json, A::Error> {
                let mut items = Vec::new();
                while let Some(item) = seq.next_element()? {
                    items.push(item);
                }
                Ok(Json::Array(items))
            }
            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Json, A::Error> {
                let mut entries = Vec::new();
                while let Some(entry) = map.next_entry()? {
                    entries.push(entry);
                }
                Ok(Json::Object(entries))
            }
        }
        deserializer.deserialize_any(JsonVisitor)
    }
}
