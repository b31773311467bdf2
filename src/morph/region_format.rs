//! How regions stand in files: a shape by itself, `{ circle = { .. } }`, or a list under `union`, `subtract` or `intersect`.

use std::fmt;

use serde::de::value::MapAccessDeserializer;
use serde::de::{DeserializeSeed, Error as _, IntoDeserializer, MapAccess, Visitor};
use serde::{Deserialize, Deserializer};

use super::{Region, Shape};

impl<'de> Deserialize<'de> for Region {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_map(OneEntry)
    }
}

struct OneEntry;

impl<'de> Visitor<'de> for OneEntry {
    type Value = Region;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a shape (circle, ellipse, sector, polygon), or union, subtract or intersect of regions")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Region, A::Error> {
        let key: String = map.next_key()?.ok_or_else(|| A::Error::custom("a region without a shape"))?;
        if !["union", "subtract", "intersect"].contains(&key.as_str()) {
            let shape = MapAccessDeserializer::new(AfterKey { key: Some(key), map });
            return Shape::deserialize(shape).map(Region::Shape);
        }
        let mut parts: Vec<Region> = map.next_value()?;
        if let Some(second) = map.next_key::<String>()? {
            return Err(A::Error::custom(format!("one region has both '{key}' and '{second}'")));
        }
        let combined = match key.as_str() {
            "union" => in_pairs(parts, Region::union),
            "intersect" => in_pairs(parts, Region::intersect),
            _ if parts.is_empty() => None,
            _ => {
                let rest = in_pairs(parts.split_off(1), Region::union);
                parts.pop().map(|first| rest.into_iter().fold(first, Region::subtract))
            }
        };
        combined.ok_or_else(|| A::Error::custom(format!("'{key}' of no regions")))
    }
}

/// Regions taken together two by two, so that a long list makes no deep tree.
fn in_pairs(mut parts: Vec<Region>, combine: fn(Region, Region) -> Region) -> Option<Region> {
    while parts.len() > 1 {
        let mut halved = Vec::with_capacity(parts.len().div_ceil(2));
        let mut rest = parts.into_iter();
        while let Some(first) = rest.next() {
            halved.push(match rest.next() {
                Some(second) => combine(first, second),
                None => first,
            });
        }
        parts = halved;
    }
    parts.pop()
}

/// A map whose first key has been read.
struct AfterKey<A> {
    key: Option<String>,
    map: A,
}

impl<'de, A: MapAccess<'de>> MapAccess<'de> for AfterKey<A> {
    type Error = A::Error;

    fn next_key_seed<K: DeserializeSeed<'de>>(&mut self, seed: K) -> Result<Option<K::Value>, A::Error> {
        match self.key.take() {
            Some(key) => seed.deserialize(key.into_deserializer()).map(Some),
            None => self.map.next_key_seed(seed),
        }
    }

    fn next_value_seed<V: DeserializeSeed<'de>>(&mut self, seed: V) -> Result<V::Value, A::Error> {
        self.map.next_value_seed(seed)
    }
}
