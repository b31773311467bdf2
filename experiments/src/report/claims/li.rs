//! Claims of Li et al., in the order of the paper.

use super::Bound::{AtLeast, AtMost};
use super::Take::{First, Mean, Variation};
use super::klimov::{Rows, alone, pick, ratio};
use super::{Claim, Pick};

const FFD: Rows = &[("model", "ffd")];
const SPRINGS: Rows = &[("model", "mass_spring")];
const ELEMENTS: Rows = &[("model", "fem")];
const LAPLACIAN: Rows = &[("model", "laplacian")];
const POISSON: Rows = &[("model", "poisson")];

const LARGE: (&str, &str) = ("size", "20000");
const LARGE_FFD: Rows = &[LARGE, FFD[0]];
const LARGE_SPRINGS: Rows = &[LARGE, SPRINGS[0]];
const LARGE_ELEMENTS: Rows = &[LARGE, ELEMENTS[0]];
const LARGE_LAPLACIAN: Rows = &[LARGE, LAPLACIAN[0]];
const LARGE_POISSON: Rows = &[LARGE, POISSON[0]];
const LARGE_DIRECT: Rows = &[LARGE, ("model", "direct")];

const fn off_asked(model: Rows) -> Pick {
    pick("mask-models", model, "off_asked", Mean)
}

const fn off_tissue(model: Rows) -> Pick {
    pick("mask-models", model, "off_tissue", Mean)
}

/// Milliseconds from the drawn mask to the first result.
const fn first(model: Rows) -> Pick {
    pick("mask-cost.timing", model, "first", Mean)
}

/// Milliseconds of a step of a dragged handle.
const fn drag(model: Rows) -> Pick {
    pick("mask-cost.timing", model, "drag", Mean)
}

const DRAWING: Rows = &[("stage", "draw and blur"), ("size", "100000")];
const WEIGHING: Rows = &[("stage", "weights, visible"), ("size", "100000")];
const MORPHING: Rows = &[("stage", "direct morph"), ("size", "100000")];

/// Milliseconds of a stage of masking.
const fn time(stage: Rows) -> Pick {
    pick("mask-speed.timing", stage, "milliseconds", Mean)
}

/// The disc of Table 1 after so many mean blurs.
const BLURS_0: Rows = &[("blur", "mean"), ("iterations", "0")];
const BLURS_20: Rows = &[("blur", "mean"), ("iterations", "20")];
const BLURS_40: Rows = &[("blur", "mean"), ("iterations", "40")];

/// The morph of Fig. 3 under each blur.
const UNBLURRED: Rows = &[("blur", "none")];
const MEAN: Rows = &[("blur", "mean")];
const GAUSSIAN: Rows = &[("blur", "gaussian")];
const WIDE_GAUSSIAN: Rows = &[("blur", "wide gaussian")];
const MEDIAN: Rows = &[("blur", "median")];

const fn jump(blur: Rows) -> Pick {
    pick("blurred-morphs", blur, "largest_jump", First)
}

const fn reached(blur: Rows) -> Pick {
    pick("blurred-morphs", blur, "reached", First)
}

/// Every sentence of the paper that claims something which can be measured.
pub const LI: &[Claim] = &[
    Claim {
        quote: "[Free-form deformation:] its advantage is that the deformation takes little computation.",
        section: "Introduction, [6, 7]",
        rule: "Over the masks, on the face of 20,000 vertices, a step of a dragged handle takes at most 40 ms of one core, a frame of 25 a \
               second.",
        rules: &[alone(drag(LARGE_FFD), AtMost(40.0))],
        remark: "As many cells over the region as the graph has nodes. Graph and as-rigid-as-possible take less.",
    },
    Claim {
        quote: "[Free-form deformation:] as the lattice influences the effect, it is hard to get an accurate deformation.",
        section: "Introduction, [6, 7]",
        rule: "The result is on average at least 5 % of the displacement away from what the mask asks, rms over the vertices that move.",
        rules: &[alone(off_asked(FFD), AtLeast(0.05))],
        remark: "Control points that move a held vertex are held: a small mask loses its rim, a large one hardly.",
    },
    Claim {
        quote: "Deformation in the differential domain has outstanding advantages over free-form deformation.",
        section: "Introduction, [11, 12]",
        rule: "Under Laplacian and under Poisson editing the result is at most two thirds as far from what the mask asks as under the lattice.",
        rules: &[
            ratio(off_asked(LAPLACIAN), off_asked(FFD), AtMost(0.667)),
            ratio(off_asked(POISSON), off_asked(FFD), AtMost(0.667)),
        ],
        remark: "",
    },
    Claim {
        quote: "[Mass-spring models:] their advantage is a small computation, which allows interaction in real time.",
        section: "Introduction, [8]",
        rule: "Over the masks, on the face of 20,000 vertices, a step of a dragged handle takes at most 40 ms of one core, and less than half of \
               that of finite elements.",
        rules: &[
            alone(drag(LARGE_SPRINGS), AtMost(40.0)),
            ratio(drag(LARGE_SPRINGS), drag(LARGE_ELEMENTS), AtMost(0.5)),
        ],
        remark: "The springs' equilibrium is found here by Gauss-Newton. Integration in time has cheaper steps and more of them, and shows what is \
                 not yet at rest.",
    },
    Claim {
        quote: "[Mass-spring models:] their disadvantage is that the result is less accurate.",
        section: "Introduction, [8]",
        rule: "It is on average at least twice as far from soft tissue as that of finite elements on the same mesh.",
        rules: &[ratio(off_tissue(SPRINGS), off_tissue(ELEMENTS), AtLeast(2.0))],
        remark: "Soft tissue is linear elasticity here, as finite elements have it: with smaller triangles they come nearer to it, springs do \
                 not. A handle at each vertex leaves little to any model.",
    },
    Claim {
        quote: "The finite element method can offer deformations of very strong realism.",
        section: "Introduction, [9]",
        rule: "It is on average at most 1 % of the displacement away from soft tissue, rms over the vertices that move.",
        rules: &[alone(off_tissue(ELEMENTS), AtMost(0.01))],
        remark: "Soft tissue is the elements' own equation on smaller triangles: what is judged is their size, not the equation. There is no \
                 patient to compare with.",
    },
    Claim {
        quote: "[The finite element method:] its computation is large, and interaction in real time is hard to achieve.",
        section: "Introduction, [9]",
        rule: "Over the masks, on the face of 20,000 vertices, a step of a dragged handle takes at least 40 ms of one core.",
        rules: &[alone(drag(LARGE_ELEMENTS), AtLeast(40.0))],
        remark: "On 5,000 vertices it takes a fraction; the paper says itself that [10] makes it real-time by regions.",
    },
    Claim {
        quote: "Algorithms in the differential domain still need to preprocess the mesh model [as direct operation does not].",
        section: "Introduction, [11, 12]",
        rule: "From the drawn mask to the first result takes at least 1.5 times a later step of the same length under Laplacian and under Poisson \
               editing, at most 1.5 times under direct operation.",
        rules: &[
            ratio(first(LARGE_LAPLACIAN), drag(LARGE_LAPLACIAN), AtLeast(1.5)),
            ratio(first(LARGE_POISSON), drag(LARGE_POISSON), AtLeast(1.5)),
            ratio(first(LARGE_DIRECT), drag(LARGE_DIRECT), AtMost(1.5)),
        ],
        remark: "So does every model with an energy.",
    },
    Claim {
        quote: "A set of texture coordinates is computed for the vertices in real time.",
        section: "Abstract, 1.1",
        rule: "Every one of 100,000 vertices gets its weight, visibility included, within 40 ms of one core, a frame of 25 a second.",
        rules: &[alone(time(WEIGHING), AtMost(40.0))],
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
            alone(time(DRAWING), AtMost(50.0)),
            alone(time(WEIGHING), AtMost(40.0)),
            alone(time(MORPHING), AtMost(10.0)),
        ],
        remark: "Nothing is kept from one morph to the next.",
    },
    Claim {
        quote: "The mean blur handles the blurring of the rim perfectly.",
        section: "1.3, Table 1",
        rule: "After 20 mean blurs no two neighbouring pixels differ by more than 3 %; before, they differ by the whole.",
        rules: &[
            alone(pick("blurs", BLURS_20, "steepest", First), AtMost(0.03)),
            alone(pick("blurs", BLURS_0, "steepest", First), AtLeast(0.9)),
        ],
        remark: "",
    },
    Claim {
        quote: "Its highest brightness in the texture decays little.",
        section: "1.3, Table 1",
        rule: "After 40 mean blurs the highest grey is at least 0.9 of the one before.",
        rules: &[ratio(
            pick("blurs", BLURS_40, "highest", First),
            pick("blurs", BLURS_0, "highest", First),
            AtLeast(0.9),
        )],
        remark: "A matter of the region's size: a disc of 50 pixels here, twice the blur's deviation of 24.",
    },
    Claim {
        quote: "The median blur works worst: the rim does not go over smoothly after the morph.",
        section: "1.3, Fig. 3",
        rule: "The largest jump across an edge is at least twice that under the mean.",
        rules: &[ratio(jump(MEDIAN), jump(MEAN), AtLeast(2.0))],
        remark: "",
    },
    Claim {
        quote: "Mean and Gaussian blur both solve this problem well.",
        section: "1.3, Fig. 3",
        rule: "Under each of them the largest jump is at most half of that without blur.",
        rules: &[ratio(jump(MEAN), jump(UNBLURRED), AtMost(0.5)), ratio(jump(GAUSSIAN), jump(UNBLURRED), AtMost(0.5))],
        remark: "",
    },
    Claim {
        quote: "Under the Gaussian the largest displacement does not reach the expected amplitude, while the mean's comes nearer to it. \
                [At equal kernel size]",
        section: "1.3, Fig. 3",
        rule: "With 13 x 13 for both, the mean reaches more than the Gaussian (by at least 0.1 %).",
        rules: &[ratio(reached(MEAN), reached(GAUSSIAN), AtLeast(1.001))],
        remark: "The Gaussian that fits into a kernel is narrower than the mean, so that it blurs less.",
    },
    Claim {
        quote: "Under the Gaussian the largest displacement does not reach the expected amplitude, while the mean's comes nearer to it. \
                [At equal variance]",
        section: "1.3, Fig. 3",
        rule: "With the Gaussian as wide as the mean, the mean reaches more (by at least 0.1 %).",
        rules: &[ratio(reached(MEAN), reached(WIDE_GAUSSIAN), AtLeast(1.001))],
        remark: "Twenty means are all but a Gaussian: the central limit theorem.",
    },
    Claim {
        quote: "The system [...] runs efficiently.",
        section: "3",
        rule: "Dragging moves 100,000 vertices within 40 ms of one core.",
        rules: &[alone(time(MORPHING), AtMost(40.0))],
        remark: "",
    },
];
