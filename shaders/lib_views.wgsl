// Views of depth peeling: windows onto the pixels of one direction and axis, side by side in one depth image.

struct PeelParams {
    // Side of a view's square cell in the depth image, pixels.
    cell: u32,
    // Cells side by side, and one above the other.
    columns: u32,
    rows: u32,
    views: u32,
}

struct PeelView {
    direction: u32,
    axis: u32,
    // Grid pixel at the cell's smallest corner.
    window_x: i32,
    window_y: i32,
}

fn cell_corner(view: u32, peel: PeelParams) -> vec2<i32> {
    return vec2<i32>(vec2<u32>(view % peel.columns, view / peel.columns) * peel.cell);
}
