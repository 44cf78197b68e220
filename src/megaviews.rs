//! MegaViews: a million views that share work.

pub mod view_tree;
