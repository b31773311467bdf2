//! Units of length of files. Inside, everything is millimetres.

use std::fmt;
use std::str::FromStr;

/// A unit of length.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LengthUnit {
    /// um
    Micrometre,
    /// mm
    Millimetre,
    /// cm
    Centimetre,
    /// m
    Metre,
}

impl LengthUnit {
    /// How many millimetres one is.
    #[must_use]
    pub fn millimetres(self) -> f64 {
        match self {
            Self::Micrometre => 1e-3,
            Self::Millimetre => 1.0,
            Self::Centimetre => 10.0,
            Self::Metre => 1000.0,
        }
    }
}

impl fmt::Display for LengthUnit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Micrometre => "um",
            Self::Millimetre => "mm",
            Self::Centimetre => "cm",
            Self::Metre => "m",
        })
    }
}

impl FromStr for LengthUnit {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "um" => Ok(Self::Micrometre),
            "mm" => Ok(Self::Millimetre),
            "cm" => Ok(Self::Centimetre),
            "m" => Ok(Self::Metre),
            _ => Err(format!("unknown unit {text:?}; known are um, mm, cm and m")),
        }
    }
}
