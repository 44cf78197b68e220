//! ManyLoDs: many cuts through one hierarchy.
