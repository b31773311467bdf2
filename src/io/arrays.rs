//! Arrays of just so many entries in files, for `deserialize_with`.

use serde::de::Error as _;
use serde::{Deserialize, Deserializer};

/// An array of just so many entries. TOML's reader takes a longer one for it and drops the rest, such as of a decimal comma.
struct Exactly<T, const N: usize>([T; N]);

impl<'de, T: Deserialize<'de>, const N: usize> Deserialize<'de> for Exactly<T, N> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let all = Vec::<T>::deserialize(deserializer)?;
        let wrong = |all: Vec<T>| D::Error::custom(format!("{} entries, expected {N}", all.len()));
        all.try_into().map(Self).map_err(wrong)
    }
}

/// Reads an array of just so many entries, for `deserialize_with`.
pub fn array<'de, D: Deserializer<'de>, T: Deserialize<'de>, const N: usize>(from: D) -> Result<[T; N], D::Error> {
    Exactly::deserialize(from).map(|array| array.0)
}

/// [`array`] of what may be missing.
pub fn optional_array<'de, D: Deserializer<'de>, T: Deserialize<'de>, const N: usize>(
    from: D,
) -> Result<Option<[T; N]>, D::Error> {
    Ok(Option::<Exactly<T, N>>::deserialize(from)?.map(|array| array.0))
}

/// [`optional_array`] of arrays.
pub fn optional_arrays<'de, D: Deserializer<'de>, T: Deserialize<'de>, const N: usize, const M: usize>(
    from: D,
) -> Result<Option<[[T; M]; N]>, D::Error> {
    Ok(Option::<Exactly<Exactly<T, M>, N>>::deserialize(from)?.map(|arrays| arrays.0.map(|array| array.0)))
}

/// Lists of lists of [arrays](array).
pub fn lists_of_arrays<'de, D: Deserializer<'de>, T: Deserialize<'de>, const N: usize>(
    from: D,
) -> Result<Vec<Vec<[T; N]>>, D::Error> {
    let lists = Vec::<Vec<Exactly<T, N>>>::deserialize(from)?;
    Ok(lists.into_iter().map(|list| list.into_iter().map(|array| array.0).collect()).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn longer_arrays_are_refused() {
        #[derive(Debug, Deserialize)]
        #[serde(deny_unknown_fields)]
        struct Keys {
            #[serde(default, deserialize_with = "optional_array")]
            by: Option<[f64; 3]>,
            #[serde(default, deserialize_with = "optional_arrays")]
            covers: Option<[[f64; 2]; 2]>,
        }
        let read = |text: &str| toml::from_str::<Keys>(text);
        let keys = read("by = [1, 2, 3]\ncovers = [[1, 2], [3, 4.5]]").unwrap();
        assert_eq!((keys.by, keys.covers), (Some([1.0, 2.0, 3.0]), Some([[1.0, 2.0], [3.0, 4.5]])));
        assert_eq!(read("").unwrap().by, None);
        for (text, found) in [("by = [0,5, 1, 2]", 4), ("by = [0, 1]", 2), ("covers = [[1, 2], [3, 4,5]]", 3)] {
            let error = read(text).unwrap_err().to_string();
            assert!(error.contains(&format!("{found} entries, expected")), "{error}");
        }
    }
}
