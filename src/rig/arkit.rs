//! Names of expressions whose weights are meant to lie between 0 and 1: the blendshapes of ARKit's face tracking
//! (`ARFaceAnchor.BlendShapeLocation`), which most rigs of faces follow, and the one that ICT-FaceKit adds.

/// Without the side that pairs have.
const NAMES: [&str; 35] = [
    "browDown",
    "browInnerUp",
    "browOuterUp",
    "cheekPuff",
    "cheekRaiser",
    "cheekSquint",
    "eyeBlink",
    "eyeLookDown",
    "eyeLookIn",
    "eyeLookOut",
    "eyeLookUp",
    "eyeSquint",
    "eyeWide",
    "jawForward",
    "jawLeft",
    "jawOpen",
    "jawRight",
    "mouthClose",
    "mouthDimple",
    "mouthFrown",
    "mouthFunnel",
    "mouthLeft",
    "mouthLowerDown",
    "mouthPress",
    "mouthPucker",
    "mouthRight",
    "mouthRollLower",
    "mouthRollUpper",
    "mouthShrugLower",
    "mouthShrugUpper",
    "mouthSmile",
    "mouthStretch",
    "mouthUpperUp",
    "noseSneer",
    "tongueOut",
];

/// Whether an expression of this name goes from 0 to 1: `eyeBlinkLeft`, `eyeBlink_L`, `EyeBlink_L`.
pub(super) fn from_zero_to_one(name: &str) -> bool {
    let known = |name: &str| NAMES.iter().any(|known| known.eq_ignore_ascii_case(name));
    let lower = name.to_ascii_lowercase();
    let side = ["_left", "_right", "left", "right", "_l", "_r"];
    known(name) || side.iter().any(|side| lower.strip_suffix(side).is_some_and(known))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sides_and_case_do_not_matter() {
        for name in [
            "eyeBlinkLeft",
            "eyeBlink_R",
            "EyeBlink_L",
            "jawOpen",
            "jawLeft",
            "mouthRight",
            "browInnerUp",
            "browInnerUp_L",
        ] {
            assert!(from_zero_to_one(name), "{name}");
        }
        for name in ["expression003", "identity001", "jaw", "mouth_L", "left", "_L", "", "smile", "eyeBlinkLeftLeft"] {
            assert!(!from_zero_to_one(name), "{name}");
        }
    }
}
