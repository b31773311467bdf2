use nonrigid::mesh::io::*;
use nonrigid::mesh::*;
use nonrigid::morph::*;
use nonrigid::render::*;
use nonrigid::rig::*;
use std::path::Path;
fn main() {
    let a: Vec<String> = std::env::args().collect();
    let mesh = read_polygon_mesh(Path::new(&a[1])).unwrap();
    let lm = read_template_landmarks(Path::new(&a[2]), &mesh).unwrap();
    let regions = Regions::of_groups(&mesh);
    let shapes = ShapeBasis::none();
    let names: Vec<&str> = if a.len() > 4 { a[4].split(',').collect() } else { preset_names().to_vec() };
    let tris = mesh.triangulate();
    let frame = Frame::of(&mesh.positions).scaled(0.9);
    let mut k = 0;
    for chunk in names.chunks(5) {
        let mut sheet = Sheet::new("presets").columns(&["front", "masked", "after", "3/4", "3/4 masked", "3/4 after"]);
        for name in chunk {
            let r = preset(name).unwrap().unwrap();
            let s = Subject { mesh: &mesh, landmarks: &lm, regions: &regions, shapes: &shapes };
            for amount in r.range.unwrap().into_iter().chain([r.amount]) {
                let o = replay(&r, &s, &ReplayOptions { amount: Some(amount), ..Default::default() }).unwrap();
                let rep = &o[0].report;
                println!(
                    "{name} {amount}: moving {} asked {:.2} reached {:.2} jump {:.2} folded {} stretch {:.2}..{:.2}",
                    rep.moving, rep.asked, rep.reached, rep.largest_jump, rep.folded, rep.stretch.min, rep.stretch.max
                );
            }
            let o = replay(&r, &s, &ReplayOptions { amount: Some(r.range.unwrap()[1]), ..Default::default() }).unwrap();
            let cov = o[0].coverage();
            let after = mesh.with_positions(o[0].positions.clone()).triangulate();
            let scale = ColourScale::new(ColourMap::Viridis, 0.0, 1.0, "G", "");
            let mut panels = vec![];
            for v in [View::Front, View::ThreeQuarter] {
                let c = Camera::framing(&frame, v, [300, 300]);
                panels.push(render(&Scene::new().mesh(&tris, Style::Clay), &c, [300, 300]));
                panels.push(render(
                    &Scene::new().mesh(&tris, Style::Values(cov.clone(), scale.clone())),
                    &c,
                    [300, 300],
                ));
                panels.push(render(&Scene::new().mesh(&after, Style::Clay), &c, [300, 300]));
            }
            sheet = sheet.row(name, panels);
        }
        save_png(&sheet.render(), Path::new(&format!("{}{}.png", a[3], k))).unwrap();
        k += 1;
    }
}
