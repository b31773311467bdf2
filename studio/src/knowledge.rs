//! What the knowledge base of a new vault holds: the twenty ready operations, each with its recipe.

use nonrigid::morph::preset_text;

use crate::plan::{Preset, presets};
use crate::vault::Article;

/// The articles of a new vault.
#[must_use]
pub fn first_articles() -> Vec<Article> {
    presets().iter().map(article).collect()
}

fn article(preset: &Preset) -> Article {
    let Preset { name, about, amount, range: [low, high] } = preset;
    let part = name.split('-').next().unwrap_or(name);
    Article {
        id: 0,
        title: name.clone(),
        tags: format!("ready-operation {part}"),
        body: format!(
            "{about}\n\n- usual: **{amount} mm**\n- made for: {low} to {high} mm\n\nThe recipe below is stated in the frame of the 68 \
             landmarks, so it runs on every face that the template was wrapped onto. *Use in plan* adds its steps to the plan in work.\n\n\
             Source: one of the twenty modules that Li et al. 2018 name in section 3."
        ),
        recipe: preset_text(name).unwrap_or_default(),
    }
}
