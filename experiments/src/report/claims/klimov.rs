//! Klimov's claims, in the order of the paper.

use super::Bound::{AtLeast, AtMost};
use super::Take::{First, Last, Mean, Variation};
use super::{Bound, Claim, Pick, Rule, Take};

pub(super) type Rows = &'static [(&'static str, &'static str)];

pub(super) const fn pick(csv: &'static str, rows: Rows, column: &'static str, take: Take) -> Pick {
    Pick { csv, rows, column, take }
}

pub(super) const fn ratio(value: Pick, over: Pick, is: Bound) -> Rule {
    Rule { value, over: Some(over), is }
}

pub(super) const fn alone(value: Pick, is: Bound) -> Rule {
    Rule { value, over: None, is }
}

/// Mean rmse of the rows.
const fn rmse(csv: &'static str, rows: Rows) -> Pick {
    pick(csv, rows, "rmse", Mean)
}

/// Mean rmse of some rows over that of others.
const fn rmses(csv: &'static str, value: Rows, over: Rows, is: Bound) -> Rule {
    means(csv, "rmse", value, over, is)
}

/// Mean of a column in some rows of a table over that in others.
const fn means(csv: &'static str, column: &'static str, value: Rows, over: Rows, is: Bound) -> Rule {
    ratio(pick(csv, value, column, Mean), pick(csv, over, column, Mean), is)
}

/// How much a column varies in some rows of a table over how much in others.
const fn variations(csv: &'static str, column: &'static str, value: Rows, over: Rows, is: Bound) -> Rule {
    ratio(pick(csv, value, column, Variation), pick(csv, over, column, Variation), is)
}

/// The rmse on the finest template over that on the coarsest.
const fn finest_over_coarsest(rows: Rows, is: Bound) -> Rule {
    ratio(pick("resolution", rows, "rmse", Last), pick("resolution", rows, "rmse", First), is)
}

const MODEL: (&str, &str) = ("group", "model");
const HYBRID: Rows = &[MODEL, ("name", "hybrid")];
const GRAPH: Rows = &[MODEL, ("name", "graph")];
const RIGID: Rows = &[MODEL, ("name", "rigid")];
const BLENDSHAPE: Rows = &[MODEL, ("name", "blendshape")];
const SEQUENTIAL: Rows = &[MODEL, ("name", "sequential")];

const NOISE: (&str, &str) = ("sweep", "noise");
const NOISELESS_RIGID: Rows = &[NOISE, ("value", "0"), ("model", "rigid")];
const NOISY_RIGID: Rows = &[NOISE, ("value", "2"), ("model", "rigid")];

const MOUTH: (&str, &str) = ("sweep", "jaw");
const CLOSED_ARAP: Rows = &[MOUTH, ("value", "0"), ("model", "arap")];
const CLOSED_HYBRID: Rows = &[MOUTH, ("value", "0"), ("model", "hybrid")];
const OPEN_ARAP: Rows = &[MOUTH, ("value", "100"), ("model", "arap")];
const OPEN_GRAPH: Rows = &[MOUTH, ("value", "100"), ("model", "graph")];
const OPEN_BLENDSHAPE: Rows = &[MOUTH, ("value", "100"), ("model", "blendshape")];
const OPEN_HYBRID: Rows = &[MOUTH, ("value", "100"), ("model", "hybrid")];

const EYES_CLOSED_GRAPH: Rows = &[("sweep", "eyes"), ("value", "100"), ("model", "graph")];
const EYES_CLOSED_HYBRID: Rows = &[("sweep", "eyes"), ("value", "100"), ("model", "hybrid")];

/// Of the shapes that a scan shows, none is missing, or all are.
const MISSING: (&str, &str) = ("sweep", "missing");
const COMPLETE_HYBRID: Rows = &[MISSING, ("value", "0"), ("model", "hybrid")];
const MISSING_HYBRID: Rows = &[MISSING, ("value", "100"), ("model", "hybrid")];
const MISSING_SEQUENTIAL: Rows = &[MISSING, ("value", "100"), ("model", "sequential")];

const TEMPLATES: (&str, &str) = ("study", "template");
const SIZES_ARAP: Rows = &[TEMPLATES, ("name", "arap")];
const SIZES_GRAPH: Rows = &[TEMPLATES, ("name", "graph")];
const SIZES_SEQUENTIAL: Rows = &[TEMPLATES, ("name", "sequential")];
const TO_POINT: Rows = &[("study", "scan"), ("size", "2000"), ("name", "point_to_point")];
const TO_PLANE: Rows = &[("study", "scan"), ("size", "2000"), ("name", "point_to_plane")];

const PRIOR: Rows = &[("group", "prior"), ("name", "lambda_blend x 1")];
const NO_PRIOR: Rows = &[("group", "prior"), ("name", "lambda_blend x 0")];
const NODES_50: Rows = &[("group", "nodes"), ("name", "50")];
const NODES_800: Rows = &[("group", "nodes"), ("name", "800")];
const ROTATION: (&str, &str) = ("group", "rotation");
const MATRICES: Rows = &[ROTATION, ("name", "matrix")];
const QUATERNIONS: Rows = &[ROTATION, ("name", "quaternion")];
const ROTATION_VECTORS: Rows = &[ROTATION, ("name", "angle-axis")];

const PCA: (&str, &str) = ("family", "pca");
const PCA_5: Rows = &[PCA, ("differentiation", "ours"), ("shapes", "5")];
const PCA_50: Rows = &[PCA, ("differentiation", "ours"), ("shapes", "50")];
const PCA_150: Rows = &[PCA, ("differentiation", "ours"), ("shapes", "150")];
const RAW_50: Rows = &[("family", "raw"), ("shapes", "50")];
const PAPER: Rows = &[("differentiation", "paper"), ("quantity", "registration")];
const OURS: Rows = &[("differentiation", "ours"), ("quantity", "registration")];

/// Every sentence of the paper that claims something which can be measured.
pub const KLIMOV: &[Claim] = &[
    Claim {
        quote: "[The modified algorithm provides for] the highly accurate registration of 3D models which differ greatly.",
        section: "Abstract",
        rule: "Over the scans, each of a strong expression, the hybrid's mean rmse is at most 1 mm, and at most half of the graph's.",
        rules: &[alone(rmse("comparison", HYBRID), AtMost(1.0)), rmses("comparison", HYBRID, GRAPH, AtMost(0.5))],
        remark: "",
    },
    Claim {
        quote: "Rigid registration is, as a rule, very robust to noise.",
        section: "1.1",
        rule: "The rigid model's rmse at 2 mm of noise is at most 1.1 times that without noise.",
        rules: &[rmses("sweeps", NOISY_RIGID, NOISELESS_RIGID, AtMost(1.1))],
        remark: "Noise on top of an error of many millimetres, which is the shape's.",
    },
    Claim {
        quote: "However, it requires that source and target have practically the same shape, and so does not suit objects whose \
                shape may change a lot, such as human faces.",
        section: "1.1",
        rule: "The rigid model's mean rmse is at least 3 times the hybrid's.",
        rules: &[rmses("comparison", RIGID, HYBRID, AtLeast(3.0))],
        remark: "",
    },
    Claim {
        quote: "As-rigid-as-possible algorithms [...] allow good registration where the source is close enough to the target.",
        section: "1.1",
        rule: "With the mouth closed, as in the neutral, ARAP's rmse is at most 1.5 times the hybrid's.",
        rules: &[rmses("sweeps", CLOSED_ARAP, CLOSED_HYBRID, AtMost(1.5))],
        remark: "",
    },
    Claim {
        quote: "Unfortunately, this approach works poorly where the source is far from the target.",
        section: "1.1",
        rule: "With the mouth wide open, ARAP's rmse is at least twice the hybrid's and at least twice its own with the mouth closed.",
        rules: &[
            rmses("sweeps", OPEN_ARAP, OPEN_HYBRID, AtLeast(2.0)),
            rmses("sweeps", OPEN_ARAP, CLOSED_ARAP, AtLeast(2.0)),
        ],
        remark: "",
    },
    Claim {
        quote: "It also works poorly with models of high resolution, as ARAP then controls the global shape poorly.",
        section: "1.1, again 2.1",
        rule: "ARAP's rmse on the finest template is at least 1.2 times that on the coarsest.",
        rules: &[finest_over_coarsest(SIZES_ARAP, AtLeast(1.2))],
        remark: "Here weights scale with the template's resolution; with weights per vertex as they stand it would be otherwise.",
    },
    Claim {
        quote: "Unlike ARAP, the deformation graph works with polygonal models of any resolution.",
        section: "1.1",
        rule: "The graph's rmse on the finest template is at most 1.2 times that on the coarsest.",
        rules: &[finest_over_coarsest(SIZES_GRAPH, AtMost(1.2))],
        remark: "",
    },
    Claim {
        quote: "The graph is meant for cases where smoothness is violated evenly; with a mouth wide open the corner of the mouth \
                must deform strongly and the rest of the model little.",
        section: "1.1",
        rule: "With the mouth wide open, the graph's rmse is at least twice the hybrid's.",
        rules: &[rmses("sweeps", OPEN_GRAPH, OPEN_HYBRID, AtLeast(2.0))],
        remark: "",
    },
    Claim {
        quote: "[Blendshapes] suit the registration of models unlike each other well [...]",
        section: "1.1",
        rule: "With the mouth wide open, the blendshape model's rmse is at most half of ARAP's and of the graph's.",
        rules: &[
            rmses("sweeps", OPEN_BLENDSHAPE, OPEN_ARAP, AtMost(0.5)),
            rmses("sweeps", OPEN_BLENDSHAPE, OPEN_GRAPH, AtMost(0.5)),
        ],
        remark: "",
    },
    Claim {
        quote: "[...] but do not suit capturing fine detail, such as wrinkles.",
        section: "1.1, again 2.1",
        rule: "The blendshape model's error off the surface is on average at least 1.5 times the hybrid's.",
        rules: &[means("comparison", "normal", BLENDSHAPE, HYBRID, AtLeast(1.5))],
        remark: "",
    },
    Claim {
        quote: "[Blendshapes first, ARAP after] does not allow to repair mistakes of registration that the first step has made.",
        section: "1.1",
        rule: "Without any of the shown shapes, the sequential method's rmse is at least 1.25 times the hybrid's.",
        rules: &[rmses("sweeps", MISSING_SEQUENTIAL, MISSING_HYBRID, AtLeast(1.25))],
        remark: "",
    },
    Claim {
        quote: "It also has all the problems of algorithms based on ARAP.",
        section: "1.1",
        rule: "The sequential method's rmse on the finest template is at least 1.2 times that on the coarsest.",
        rules: &[finest_over_coarsest(SIZES_SEQUENTIAL, AtLeast(1.2))],
        remark: "",
    },
    Claim {
        quote: "The distance from point to point is not always the best choice; ICP may be unstable where the scan has few vertices.",
        section: "1.2",
        rule: "On a scan of 2,000 triangles, the hybrid's rmse with point-to-point is at least 1.2 times that with point-to-plane.",
        rules: &[rmses("resolution", TO_POINT, TO_PLANE, AtLeast(1.2))],
        remark: "",
    },
    Claim {
        quote: "Though the data term matters, it is often the choice of the deformation model that has the key influence on quality.",
        section: "1.2",
        rule: "The rmse varies (standard deviation over mean) at least 1.5 times as much from model to model as from data term to \
               data term.",
        rules: &[variations("comparison", "rmse", &[MODEL], &[("group", "term")], AtLeast(1.5))],
        remark: "Both vary with the scan as well.",
    },
    Claim {
        quote: "A smiling blendshape applied with a weight of 2 will most likely give a model that is not like a face at all; so it \
                makes sense to regularise the weights.",
        section: "2.1, eq. (5)",
        rule: "Without the prior, the largest weight is at least 1.5 times as large, and the rmse larger.",
        rules: &[
            means("ablations", "largest_weight", NO_PRIOR, PRIOR, AtLeast(1.5)),
            rmses("ablations", NO_PRIOR, PRIOR, AtLeast(1.0)),
        ],
        remark: "",
    },
    Claim {
        quote: "Rotations are parametrised by orthonormal matrices; any other parametrisation may be used, quaternions included.",
        section: "2.1",
        rule: "The rmse with unit quaternions and with angle-axis is within 2 % of that with matrices.",
        rules: &[
            rmses("ablations", QUATERNIONS, MATRICES, AtMost(1.02)),
            rmses("ablations", QUATERNIONS, MATRICES, AtLeast(0.98)),
            rmses("ablations", ROTATION_VECTORS, MATRICES, AtMost(1.02)),
            rmses("ablations", ROTATION_VECTORS, MATRICES, AtLeast(0.98)),
        ],
        remark: "",
    },
    Claim {
        quote: "One may choose a different number of nodes: a small one for coarse deformations, a large one for fine ones.",
        section: "2.1",
        rule: "With 50 nodes, the error off the surface is at least 1.3 times that with 800.",
        rules: &[means("ablations", "normal", NODES_50, NODES_800, AtLeast(1.3))],
        remark: "",
    },
    Claim {
        quote: "The graph cannot capture uneven deformations, as of a scan with a closed eye.",
        section: "2.1",
        rule: "With closed eyes, the graph's rmse is at least 1.5 times the hybrid's.",
        rules: &[rmses("sweeps", EYES_CLOSED_GRAPH, EYES_CLOSED_HYBRID, AtLeast(1.5))],
        remark: "",
    },
    Claim {
        quote: "Joined, the blendshapes define the possible uneven deformations and the graph captures the fine detail.",
        section: "2.1, eq. (8)",
        rule: "The hybrid's mean rmse is below that of its parts, blendshapes and graph, and of the two in sequence.",
        rules: &[
            rmses("comparison", HYBRID, BLENDSHAPE, AtMost(1.0)),
            rmses("comparison", HYBRID, GRAPH, AtMost(1.0)),
            rmses("comparison", HYBRID, SEQUENTIAL, AtMost(1.0)),
        ],
        remark: "",
    },
    Claim {
        quote: "The number of blendshapes directly influences the quality.",
        section: "2.2",
        rule: "With 5 PCA components the mean rmse is at least 1.2 times that with 150.",
        rules: &[rmses("shapes", PCA_5, PCA_150, AtLeast(1.2))],
        remark: "",
    },
    Claim {
        quote: "A large number of blendshapes lowers the speed considerably, as more operations are needed for residuals and \
                derivatives, and there are more variables.",
        section: "2.2",
        rule: "By the paper's differentiation, a registration with the most components takes at least twice as long as with the fewest.",
        rules: &[alone(pick("shapes-fit.timing", PAPER, "last_over_first", Mean), AtLeast(2.0))],
        remark: "",
    },
    Claim {
        quote: "Where no blendshape resembles the target scan, convergence and quality may suffer strongly.",
        section: "2.2",
        rule: "Without any of the shown shapes, the hybrid's rmse is at least 1.5 times that with all of them.",
        rules: &[rmses("sweeps", MISSING_HYBRID, COMPLETE_HYBRID, AtLeast(1.5))],
        remark: "",
    },
    Claim {
        quote: "[With PCA components in place of raw blendshapes] quality and speed of convergence depend less on the particular \
                target scan.",
        section: "2.2",
        rule: "With 50 components, rmse and steps vary (standard deviation over mean) less from scan to scan than with 50 raw shapes.",
        rules: &[
            variations("shapes", "rmse", PCA_50, RAW_50, AtMost(1.0)),
            variations("shapes", "iterations", PCA_50, RAW_50, AtMost(1.0)),
        ],
        remark: "Few scans: the variation itself is uncertain.",
    },
    Claim {
        quote: "The speed of the method depends practically linearly on the number of blendshapes.",
        section: "2.2, Fig. 4",
        rule: "By the paper's differentiation: no time lies farther from a straight line than a tenth of what the line rises by.",
        rules: &[alone(pick("shapes-fit.timing", PAPER, "departure", Mean), AtMost(0.1))],
        remark: "A line for each scan, through the least processor time of the repetitions.",
    },
    Claim {
        quote: "Where time is critical, it makes sense to use as few blendshapes as possible.",
        section: "2.2",
        rule: "By our differentiation, a registration with the most components takes at least 1.5 times as long as with the fewest.",
        rules: &[alone(pick("shapes-fit.timing", OURS, "last_over_first", Mean), AtLeast(1.5))],
        remark: "It is a claim about the method; by our differentiation a further shape costs a dense update, no derivatives.",
    },
    Claim {
        quote: "The time may differ with topology and implementation, but its dependence on the number of blendshapes will remain.",
        section: "2.2",
        rule: "By our differentiation, the share of the time that grows with the shapes is at least half of that by the paper's.",
        rules: &[means("shapes-fit.timing", "growing_share", OURS, PAPER, AtLeast(0.5))],
        remark: "",
    },
];
