//! Templates that are one surface only once they are sewn along their seams and face one way, and vertices that are of no surface.

use crate::laws::{bits, small_task};
use crate::task::Task;
use nonrigid::landmark::TemplatePoint;
use nonrigid::mesh::{PolygonMesh, TriangleMesh, Vec3};
use nonrigid::registration::{
    ModelKind, RegistrationInput, RegistrationResult, Silent, TemplateRepair, add_detail, register,
};
use nonrigid::rig::{Family, Shape, ShapeBasis};

fn fit(task: &Task, model: ModelKind) -> RegistrationResult {
    fit_input(&task.input(), model).unwrap_or_else(|e| panic!("{model}: {e}"))
}

fn fit_input(
    input: &RegistrationInput<'_>,
    model: ModelKind,
) -> Result<RegistrationResult, nonrigid::registration::RegistrationError> {
    register(input, &model, &model.schedule().unwrap(), &mut Silent)
}

/// The task with triangles for polygons.
fn of_triangles() -> Task {
    let task = small_task();
    Task { template: task.template.triangulate().into(), ..task }
}

/// The template cut along the middle: whose vertex each of the new ones is, and the task with landmarks and masks on the new ones.
fn cut(whole: &Task) -> (Vec<u32>, Task) {
    let mesh = whole.template.triangulate();
    let right = |t: &[u32; 3]| t.iter().map(|&v| mesh.positions[v as usize].x).sum::<f64>() > 0.0;
    let used = |side: bool| {
        let mut used = vec![false; mesh.positions.len()];
        let of_side = mesh.triangles.iter().filter(|t| right(t) == side);
        of_side.flatten().for_each(|&v| used[v as usize] = true);
        used
    };
    let (left_uses, right_uses) = (used(false), used(true));
    let doubled: Vec<u32> =
        (0..).zip(left_uses.iter().zip(right_uses)).filter(|(_, (l, r))| **l && *r).map(|d| d.0).collect();
    assert!(doubled.len() > 20, "the cut runs through the face");
    let count = mesh.positions.len() as u32;
    let copy = |v: u32| doubled.binary_search(&v).map_or(v, |k| count + k as u32);
    let own: Vec<u32> = (0..count).chain(doubled.iter().copied()).collect();
    let triangles = mesh.triangles.iter().map(|t| if right(t) { t.map(copy) } else { *t }).collect();
    let positions = own.iter().map(|&v| mesh.positions[v as usize]).collect();
    let mut task = Task {
        template: TriangleMesh { positions, triangles }.into(),
        shapes: whole.shapes.masked(&own, &vec![1.0; own.len()]),
        ..whole.clone()
    };
    for landmark in &mut task.landmarks {
        if let TemplatePoint::Vertex(v) = &mut landmark.template {
            *v = copy(*v);
        }
    }
    for mask in [&mut task.mask, &mut task.free_mask].into_iter().flatten() {
        *mask = own.iter().map(|&v| mask[v as usize]).collect();
    }
    (own, task)
}

#[test]
fn a_template_that_is_cut_is_registered_as_if_it_were_whole() {
    let mut whole = of_triangles();
    let count = whole.template.positions.len();
    whole.mask = Some((0..count).map(|v| if v % 3 == 0 { 0.5 } else { 1.0 }).collect());
    whole.free_mask = Some((0..count).map(|v| if v % 7 == 0 { 0.2 } else { 0.0 }).collect());
    let (own, torn) = cut(&whole);
    for model in ModelKind::ALL {
        let (one, other) = (fit(&whole, model), fit(&torn, model));
        assert_eq!(one.template_repair, TemplateRepair::default());
        assert_eq!(other.template_repair, TemplateRepair { sewn: own.len() - count, turned: 0 });
        let expected: Vec<_> = own.iter().map(|&v| one.positions[v as usize]).collect();
        assert_eq!(bits(&expected), bits(&other.positions), "{model}");
        assert_eq!(own.iter().map(|&v| one.accepted[v as usize]).collect::<Vec<_>>(), other.accepted, "{model}");
        assert_eq!(own.iter().map(|&v| one.hidden[v as usize]).collect::<Vec<_>>(), other.hidden, "{model}");
        assert_eq!(one.weights, other.weights, "{model}");
    }
    // every triangle by itself
    let mesh = whole.template.triangulate();
    let corners = mesh.triangles.as_flattened();
    let soup = TriangleMesh {
        positions: corners.iter().map(|&v| mesh.positions[v as usize]).collect(),
        triangles: (0..mesh.triangles.len() as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect(),
    };
    let mut task =
        Task { template: soup.into(), shapes: ShapeBasis::none(), mask: None, free_mask: None, ..whole.clone() };
    for landmark in &mut task.landmarks {
        if let TemplatePoint::Vertex(v) = &mut landmark.template {
            *v = corners.iter().position(|c| c == v).unwrap() as u32;
        }
    }
    let result = fit(&task, ModelKind::Arap);
    let mut at = vec![None; count];
    for (&v, p) in corners.iter().zip(&result.positions) {
        assert_eq!(*at[v as usize].get_or_insert(p), p, "corners of vertex {v} stay together");
    }
    assert!(result.positions.iter().zip(&task.template.positions).any(|(p, q)| (p - q).norm() > 1.0));
}

#[test]
fn a_shape_that_opens_a_seam_keeps_it_open() {
    let whole = of_triangles();
    let (own, torn) = cut(&whole);
    let count = whole.template.positions.len();
    // the copies rise by 1 mm
    let opens = (0..own.len()).flat_map(|v| [0.0, 0.0, if v < count { 0.0 } else { 1.0 }]).collect();
    let opens = ShapeBasis::new(vec![Shape { name: "open".to_owned(), family: Family::Expression }], opens);
    let task = Task { shapes: torn.shapes.joined(&opens), ..torn.clone() };
    assert_eq!(fit(&task, ModelKind::Hybrid).template_repair, TemplateRepair::default());
    let rounding = (0..own.len()).flat_map(|v| [0.0, 0.0, if v < count { 0.0 } else { 1e-4 }]).collect();
    let rounding = ShapeBasis::new(vec![Shape { name: "rounding".to_owned(), family: Family::Expression }], rounding);
    let task = Task { shapes: torn.shapes.joined(&rounding), ..torn };
    assert_eq!(fit(&task, ModelKind::Hybrid).template_repair.sewn, own.len() - count);
}

#[test]
fn triangles_that_face_against_their_neighbours_are_turned_for_the_registration() {
    let whole = of_triangles();
    let mut mesh = whole.template.triangulate();
    mesh.triangles.iter_mut().step_by(5).for_each(|t| t.swap(1, 2));
    let turned = mesh.triangles.len().div_ceil(5);
    let mixed = Task { template: PolygonMesh::from(mesh), ..whole.clone() };
    for model in [ModelKind::Hybrid, ModelKind::Graph, ModelKind::Arap] {
        let (one, other) = (fit(&whole, model), fit(&mixed, model));
        assert_eq!(other.template_repair, TemplateRepair { sewn: 0, turned });
        assert_eq!(bits(&one.positions), bits(&other.positions), "{model}");
        let [one, other] = [(&whole, &one), (&mixed, &other)]
            .map(|(task, result)| nonrigid::registration::assess(&task.input(), result).unwrap());
        assert_eq!(one, other, "{model}: judged alike");
    }
}

#[test]
fn a_vertex_of_no_triangle_has_no_say_in_the_others() {
    let whole = of_triangles();
    let count = whole.template.positions.len() as u32;
    let own: Vec<u32> = (0..=count).map(|v| v.min(count - 1)).collect();
    let moved: Vec<f64> = (0..=count).map(|v| if v < count { 1.0 } else { 0.0 }).collect();
    let mut mesh = whole.template.triangulate();
    mesh.positions.push(Vec3::new(50_000.0, 0.0, 0.0));
    let stray = Task { template: mesh.into(), shapes: whole.shapes.masked(&own, &moved), ..whole.clone() };
    for model in ModelKind::ALL {
        let (one, other) = (fit(&whole, model), fit(&stray, model));
        let apart = one.positions.iter().zip(&other.positions).map(|(p, q)| (p - q).norm());
        let apart = apart.fold(0.0, f64::max);
        // A model of one node turns about the centroid of all vertices, and steps end before all is still.
        assert!(apart < 0.02, "{model}: {apart} mm");
    }
}

#[test]
fn a_warm_start_of_another_order_of_vertices_is_refused() {
    let task = of_triangles();
    let end = fit(&task, ModelKind::Arap).end;
    let warm = RegistrationInput { warm_start: Some(&end), ..task.input() };
    fit_input(&warm, ModelKind::Arap).unwrap();
    let mut mesh = task.template.triangulate();
    mesh.positions.swap(3, 200);
    let swapped = |v: u32| {
        if v == 3 {
            200
        } else if v == 200 {
            3
        } else {
            v
        }
    };
    mesh.triangles.iter_mut().for_each(|t| *t = t.map(swapped));
    let other = PolygonMesh::from(mesh);
    let error = fit_input(&RegistrationInput { template: &other, ..warm }, ModelKind::Arap).unwrap_err().to_string();
    assert!(error.contains("vertices in another order"), "{error}");
    // those of earlier versions say nothing of their template
    let earlier = nonrigid::registration::WarmStart { template: String::new(), ..end.clone() };
    fit_input(&RegistrationInput { template: &other, warm_start: Some(&earlier), ..warm }, ModelKind::Arap).unwrap();
}

#[test]
fn a_template_that_is_cut_is_divided_as_if_it_were_whole() {
    let whole = of_triangles();
    let (own, torn) = cut(&whole);
    let [one, other] = [&whole, &torn].map(|task| {
        let detail = add_detail(&task.input(), &fit(task, ModelKind::Sumner), 1, &mut Silent).unwrap();
        assert_eq!(detail.result.positions.len(), detail.template.positions.len());
        detail.result.positions
    });
    let farthest = own.iter().zip(&other).map(|(&v, p)| (one[v as usize] - p).norm()).fold(0.0, f64::max);
    assert!(farthest < 0.01, "{farthest}");
    let count = whole.template.positions.len();
    assert!(own.iter().zip(&other).skip(count).all(|(&v, p)| other[v as usize] == *p), "copies stay together");
}

#[test]
fn landmarks_outside_the_template_are_refused_whether_it_is_cut_or_not() {
    let whole = of_triangles();
    let torn = cut(&whole).1;
    for task in [whole, torn] {
        let beyond = task.template.positions.len() as u32;
        let inside = TemplatePoint::Face { corners: [0, 1, beyond], weights: [0.5, 0.3, 0.2] };
        for place in [TemplatePoint::Vertex(beyond), inside] {
            let mut task = task.clone();
            task.landmarks[0].template = place;
            let error = fit_input(&task.input(), ModelKind::Graph).unwrap_err().to_string();
            assert!(error.contains(&format!("vertex {beyond}")), "{error}");
        }
    }
}
