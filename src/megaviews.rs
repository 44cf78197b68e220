//! MegaViews: a million views that share work.
