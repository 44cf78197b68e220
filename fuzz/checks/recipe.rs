//! Any text as a recipe: refused with a reason, or settings that can be checked and are the same when read again.

use manyview_pipeline::recipe::Recipe;
use std::path::Path;

/// Fails if the rule is broken.
pub(crate) fn check(data: &[u8]) {
    let Ok(text) = str::from_utf8(data) else { return };
    match Recipe::parse(text, Path::new("folder")) {
        Ok(recipe) => {
            // Either may come of it: a recipe may ask for 99 levels, which the bake refuses.
            _ = recipe.options.check();
            if let Some(cube) = recipe.options.cube {
                assert!(
                    cube.size > 0.0 && cube.size.is_finite() && cube.origin.iter().all(|o| o.is_finite())
                );
            }
            if let Some(rows) = recipe.options.rows {
                assert!((5..=8).contains(&rows.bits));
            }
            // Not by `==` alone, which a time of NaN would fail.
            let again = Recipe::parse(text, Path::new("folder")).map(|again| format!("{again:?}"));
            assert_eq!(again, Ok(format!("{recipe:?}")));
        }
        Err(reason) => assert!(!reason.is_empty()),
    }
}
