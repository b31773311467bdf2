fn main() {
    let rig = data_gen::FaceRig::generate(&data_gen::FaceOptions::default());
    let scans: Vec<_> = (0..3)
        .map(|k| (format!("scan {k}"), data_gen::simulate_scan(&rig, &data_gen::ScanOptions::default(), k).unwrap()))
        .collect();
    nonrigid::render::save_png(
        &data_gen::contact_sheet(&rig, &scans, 7).render(),
        std::path::Path::new("/tmp/sheet.png"),
    )
    .unwrap();
}
