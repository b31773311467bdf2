//! Claims of Li et al., in the order of the paper.

use super::Bound::{AtLeast, AtMost};
use super::Claim;
use super::Take::{First, Mean, Variation};
use super::klimov::{alone, pick, ratio};

/// Every sentence of the paper that claims something which can be measured.
pub const LI: &[Claim] = &[
    Claim {
        quote: "A set of texture coordinates is computed for the vertices in real time.",
        section: "Abstract, 1.1",
        rule: "Every one of 100,000 vertices gets its weight, visibility included, within 40 ms of one core, a frame of 25 a second.",
        rules: &[alone(
            pick("mask-speed.timing", &[("stage", "weights, visible"), ("size", "100000")], "milliseconds", Mean),
            AtMost(40.0),
        )],
        remark: "The paper does without a test of visibility.",
    },
    Claim {
        quote: "The morphing information is stored in the grey texture, so that it and the model's geometric information are \
                independent of each other.",
        section: "Abstract, 5",
        rule: "On other people, meshes and resolutions each preset reaches its displacement: over all of them the share reached varies \
               (standard deviation over mean) by at most 5 %.",
        rules: &[alone(pick("presets", &[], "reached_over_asked", Variation), AtMost(0.05))],
        remark: "Recipes are in landmark coordinates here; the paper's selection is made anew on each face.",
    },
    Claim {
        quote: "Direct operation on the vertices can control the morphing effect accurately.",
        section: "Abstract, 5",
        rule: "Over all presets and faces the longest displacement is on average at least 95 % of the one asked for.",
        rules: &[alone(pick("presets", &[], "reached_over_asked", Mean), AtLeast(0.95))],
        remark: "Accurate where the mask is 1; in between the blur decides.",
    },
    Claim {
        quote: "There is no need to preprocess the 3D model.",
        section: "Abstract, 5",
        rule: "From region to moved vertices, 100,000 of them, everything takes at most 100 ms of one core: drawing and blurring, weights, morph.",
        rules: &[
            alone(
                pick("mask-speed.timing", &[("stage", "draw and blur"), ("size", "100000")], "milliseconds", Mean),
                AtMost(50.0),
            ),
            alone(
                pick("mask-speed.timing", &[("stage", "weights, visible"), ("size", "100000")], "milliseconds", Mean),
                AtMost(40.0),
            ),
            alone(
                pick("mask-speed.timing", &[("stage", "direct morph"), ("size", "100000")], "milliseconds", Mean),
                AtMost(10.0),
            ),
        ],
        remark: "Nothing is kept from one morph to the next.",
    },
    Claim {
        quote: "The mean blur handles the blurring of the rim perfectly.",
        section: "1.3, Table 1",
        rule: "After 20 mean blurs no two neighbouring pixels differ by more than 3 %; before, they differ by the whole.",
        rules: &[
            alone(pick("blurs", &[("blur", "mean"), ("iterations", "20")], "steepest", First), AtMost(0.03)),
            alone(pick("blurs", &[("blur", "mean"), ("iterations", "0")], "steepest", First), AtLeast(0.9)),
        ],
        remark: "",
    },
    Claim {
        quote: "Its highest brightness in the texture decays little.",
        section: "1.3, Table 1",
        rule: "After 40 mean blurs the highest grey is at least 0.9 of the one before.",
        rules: &[ratio(
            pick("blurs", &[("blur", "mean"), ("iterations", "40")], "highest", First),
            pick("blurs", &[("blur", "mean"), ("iterations", "0")], "highest", First),
            AtLeast(0.9),
        )],
        remark: "A matter of the region's size: a disc of 50 pixels here, twice the blur's deviation of 24.",
    },
    Claim {
        quote: "The median blur works worst: the rim does not go over smoothly after the morph.",
        section: "1.3, Fig. 3",
        rule: "The largest jump across an edge is at least twice that under the mean.",
        rules: &[ratio(
            pick("blurred-morphs", &[("blur", "median")], "largest_jump", First),
            pick("blurred-morphs", &[("blur", "mean")], "largest_jump", First),
            AtLeast(2.0),
        )],
        remark: "",
    },
    Claim {
        quote: "Mean and Gaussian blur both solve this problem well.",
        section: "1.3, Fig. 3",
        rule: "Under each of them the largest jump is at most half of that without blur.",
        rules: &[
            ratio(
                pick("blurred-morphs", &[("blur", "mean")], "largest_jump", First),
                pick("blurred-morphs", &[("blur", "none")], "largest_jump", First),
                AtMost(0.5),
            ),
            ratio(
                pick("blurred-morphs", &[("blur", "gaussian")], "largest_jump", First),
                pick("blurred-morphs", &[("blur", "none")], "largest_jump", First),
                AtMost(0.5),
            ),
        ],
        remark: "",
    },
    Claim {
        quote: "Under the Gaussian the largest displacement does not reach the expected amplitude, while the mean's comes nearer to it. \
                [At equal kernel size]",
        section: "1.3, Fig. 3",
        rule: "With 13 x 13 for both, the mean reaches more than the Gaussian (by at least 0.1 %).",
        rules: &[ratio(
            pick("blurred-morphs", &[("blur", "mean")], "reached", First),
            pick("blurred-morphs", &[("blur", "gaussian")], "reached", First),
            AtLeast(1.001),
        )],
        remark: "The Gaussian that fits into a kernel is narrower than the mean, so that it blurs less.",
    },
    Claim {
        quote: "Under the Gaussian the largest displacement does not reach the expected amplitude, while the mean's comes nearer to it. \
                [At equal variance]",
        section: "1.3, Fig. 3",
        rule: "With the Gaussian as wide as the mean, the mean reaches more (by at least 0.1 %).",
        rules: &[ratio(
            pick("blurred-morphs", &[("blur", "mean")], "reached", First),
            pick("blurred-morphs", &[("blur", "wide gaussian")], "reached", First),
            AtLeast(1.001),
        )],
        remark: "Twenty means are all but a Gaussian: the central limit theorem.",
    },
    Claim {
        quote: "The system [...] runs efficiently.",
        section: "3",
        rule: "Dragging moves 100,000 vertices within 40 ms of one core.",
        rules: &[alone(
            pick("mask-speed.timing", &[("stage", "direct morph"), ("size", "100000")], "milliseconds", Mean),
            AtMost(40.0),
        )],
        remark: "",
    },
];
