//! Accessors: typed, possibly interleaved, possibly sparse views of buffers, checked against the bytes that are there.

use super::budget::Budget;
use super::document::{Loaded, SparsePart};
use crate::io::ReadError;

/// Where elements lie: each `size` bytes, `stride` apart.
struct Elements<'a> {
    bytes: &'a [u8],
    stride: usize,
    component: Component,
}

#[derive(Debug, Clone, Copy)]
struct Component {
    code: u32,
    size: usize,
}

impl Component {
    fn of(code: u32) -> Option<Self> {
        let size = match code {
            5120 | 5121 => 1,
            5122 | 5123 => 2,
            5125 | 5126 => 4,
            _ => return None,
        };
        Some(Self { code, size })
    }

    fn value(self, b: &[u8], normalized: bool) -> f64 {
        let (value, most) = match self.code {
            5120 => (f64::from(b[0] as i8), 127.0),
            5121 => (f64::from(b[0]), 255.0),
            5122 => (f64::from(i16::from_le_bytes([b[0], b[1]])), 32767.0),
            5123 => (f64::from(u16::from_le_bytes([b[0], b[1]])), 65535.0),
            5125 => (f64::from(u32::from_le_bytes([b[0], b[1], b[2], b[3]])), f64::from(u32::MAX)),
            _ => return f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]])),
        };
        if normalized { (value / most).max(-1.0) } else { value }
    }
}

/// Reads accessors of one file.
pub(super) struct Accessors<'a> {
    file: &'a Loaded<'a>,
    pub budget: Budget<'a>,
}

impl<'a> Accessors<'a> {
    pub fn new(file: &'a Loaded<'a>) -> Self {
        Self { file, budget: Budget::new(file) }
    }

    /// All numbers of accessor `index`, of type `kind` with `width` numbers an element; finite.
    pub fn read(&self, index: usize, kind: &str, width: usize, what: &str) -> Result<Vec<f64>, ReadError> {
        let file = self.file;
        let accessor = file.entry(&file.document.accessors, index, "accessors")?;
        let name = format!("accessor {index} ({what})");
        if accessor.kind != kind {
            return file.malformed(format!("{name} of type {kind}"), format!("{:?}", accessor.kind));
        }
        let count = accessor.count;
        let mut values = match accessor.buffer_view {
            None => {
                self.budget.spend(count.saturating_mul(width), &name)?; // zeros, however many are claimed
                vec![0.0; count * width]
            }
            Some(view) => {
                let part = (view, accessor.byte_offset, accessor.component_type);
                let elements = self.elements(part, count, width, &name)?;
                self.budget.spend(count.saturating_mul(width), &name)?;
                decode(&elements, count, width, accessor.normalized)
            }
        };
        if let Some(sparse) = &accessor.sparse {
            if sparse.count > count {
                return file.malformed(format!("{name} with at most {count} sparse values"), sparse.count.to_string());
            }
            let part = |p: &SparsePart, component_type| (p.buffer_view, p.byte_offset, component_type);
            let indices = part(&sparse.indices, sparse.indices.component_type);
            let indices = decode(&self.elements(indices, sparse.count, 1, &name)?, sparse.count, 1, false);
            let new = part(&sparse.values, accessor.component_type);
            let new = self.elements(new, sparse.count, width, &name)?;
            let new = decode(&new, sparse.count, width, accessor.normalized);
            for (i, element) in indices.iter().zip(new.chunks_exact(width)) {
                let Some(i) = whole(*i, count) else {
                    return file.malformed(format!("{name} with sparse indices below {count}"), i.to_string());
                };
                values[i * width..(i + 1) * width].copy_from_slice(element);
            }
        }
        match values.iter().position(|v| !v.is_finite()) {
            None => Ok(values),
            Some(i) => {
                file.malformed(format!("{name} with finite numbers"), format!("{} at element {}", values[i], i / width))
            }
        }
    }

    /// The numbers of accessor `index` as indices below `limit`.
    pub fn read_indices(&self, index: usize, limit: usize) -> Result<Vec<u32>, ReadError> {
        let values = self.read(index, "SCALAR", 1, "indices")?;
        let indices: Option<Vec<u32>> = values.iter().map(|v| whole(*v, limit).map(|i| i as u32)).collect();
        match indices {
            Some(indices) => Ok(indices),
            None => {
                let wrong = values.iter().find(|v| whole(**v, limit).is_none());
                self.file.malformed(
                    format!("vertex indices below {limit} in accessor {index}"),
                    wrong.map_or_else(String::new, f64::to_string),
                )
            }
        }
    }

    /// The bytes of `count` elements of a (view, offset, component type); none if there are none.
    fn elements(
        &self,
        (view, offset, component_type): (usize, usize, u32),
        count: usize,
        width: usize,
        name: &str,
    ) -> Result<Elements<'a>, ReadError> {
        let file = self.file;
        let Some(component) = Component::of(component_type) else {
            return file.malformed(format!("{name} of component type 5120 to 5126"), component_type.to_string());
        };
        let view_of = file.entry(&file.document.buffer_views, view, "buffer views")?;
        let buffer = file.entry(&file.buffers, view_of.buffer, "buffers")?;
        let end = view_of.byte_offset.checked_add(view_of.byte_length);
        let Some(bytes) = end.and_then(|end| buffer.get(view_of.byte_offset..end)) else {
            let expected = format!("buffer view {view} inside the {} bytes of buffer {}", buffer.len(), view_of.buffer);
            return file
                .malformed(expected, format!("bytes from {}, {} long", view_of.byte_offset, view_of.byte_length));
        };
        let size = component.size * width;
        let stride = view_of.byte_stride.unwrap_or(size);
        if stride < size {
            return file.malformed(format!("{name} with elements at least {size} bytes apart"), stride.to_string());
        }
        let end = count.checked_sub(1).map_or(Some(0), |last| last.checked_mul(stride)?.checked_add(size));
        match bytes.get(offset..).filter(|rest| end.is_some_and(|end| end <= rest.len())) {
            Some(bytes) => Ok(Elements { bytes, stride, component }),
            None => {
                let found = format!("{} bytes from {offset} in buffer view {view}", bytes.len().saturating_sub(offset));
                file.malformed(format!("{count} elements of {size} bytes for {name}"), found)
            }
        }
    }
}

/// `count` elements, which are known to be there.
fn decode(elements: &Elements<'_>, count: usize, width: usize, normalized: bool) -> Vec<f64> {
    let Elements { bytes, stride, component } = elements;
    let mut values = Vec::with_capacity(count * width);
    for i in 0..count {
        let element = &bytes[i * stride..i * stride + width * component.size];
        values.extend(element.chunks_exact(component.size).map(|b| component.value(b, normalized)));
    }
    values
}

/// A number as an index below `limit`.
fn whole(value: f64, limit: usize) -> Option<usize> {
    (value >= 0.0 && value.fract() == 0.0 && value < limit as f64).then_some(value as usize)
}
