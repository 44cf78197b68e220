//! Typed views of bytes: plain, strided, normalized, sparse, or all zero.

use super::error::ImportError;
use super::json::Json;
use super::resources::Resources;

/// Most elements of an accessor that has no data of its own, so that a short file cannot ask for much memory.
const MAX_ZERO_ELEMENTS: usize = 1 << 24;

/// Type of one component.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Component {
    I8,
    U8,
    I16,
    U16,
    U32,
    F32,
}

impl Component {
    fn parse(object: &Json<'_>) -> Result<Self, ImportError> {
        match object.required_index("componentType")? {
            5120 => Ok(Self::I8),
            5121 => Ok(Self::U8),
            5122 => Ok(Self::I16),
            5123 => Ok(Self::U16),
            5125 => Ok(Self::U32),
            5126 => Ok(Self::F32),
            other => Err(object.malformed_at("componentType", format!("{other} is no component type"))),
        }
    }

    fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::U32 | Self::F32 => 4,
        }
    }

    /// What one unit of a normalized integer stands for.
    pub(super) fn unit(self) -> f32 {
        match self {
            Self::I8 => 1.0 / 127.0,
            Self::U8 => 1.0 / 255.0,
            Self::I16 => 1.0 / 32767.0,
            Self::U16 => 1.0 / 65535.0,
            Self::U32 | Self::F32 => 1.0,
        }
    }

    /// The component at the start of `bytes`, which must be long enough.
    fn read(self, bytes: &[u8]) -> f32 {
        match self {
            Self::I8 => f32::from(bytes[0] as i8),
            Self::U8 => f32::from(bytes[0]),
            Self::I16 => f32::from(i16::from_le_bytes([bytes[0], bytes[1]])),
            Self::U16 => f32::from(u16::from_le_bytes([bytes[0], bytes[1]])),
            Self::U32 => u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]) as f32,
            Self::F32 => f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]),
        }
    }

    /// The unsigned integer at the start of `bytes`, which must be long enough.
    fn read_index(self, bytes: &[u8]) -> u32 {
        match self {
            Self::U16 | Self::I16 => u32::from(u16::from_le_bytes([bytes[0], bytes[1]])),
            Self::U32 | Self::F32 => u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]),
            Self::U8 | Self::I8 => u32::from(bytes[0]),
        }
    }
}

/// Which elements to read: all, or the listed ones in ascending order.
pub(super) type Selection<'s> = Option<&'s [u32]>;

/// An accessor whose numbers make sense; its data is not looked at yet.
#[derive(Debug, Clone)]
pub(super) struct Accessor<'a> {
    object: Json<'a>,
    /// Elements.
    pub(super) count: usize,
    /// Components an element.
    pub(super) width: usize,
    /// Type of a component.
    pub(super) component: Component,
    /// Integers stand for fractions.
    pub(super) normalized: bool,
    view: Option<usize>,
    offset: usize,
}

/// Elements in memory: the first byte of element i is `i * stride`.
struct Elements<'r> {
    bytes: &'r [u8],
    stride: usize,
}

impl<'r> Elements<'r> {
    fn get(&self, index: usize) -> &'r [u8] {
        &self.bytes[index * self.stride..]
    }
}

impl<'a> Accessor<'a> {
    /// Accessor `index` of the document.
    pub(super) fn parse(resources: &Resources<'a>, index: usize) -> Result<Self, ImportError> {
        let object = resources.root.item("accessors", index)?;
        let width = match object.string("type")? {
            Some("SCALAR") => 1,
            Some("VEC2") => 2,
            Some("VEC3") => 3,
            Some("VEC4") => 4,
            Some("MAT4") => 16,
            Some(other) => return Err(object.malformed_at("type", format!("\"{other}\" is of no use here"))),
            None => return Err(object.malformed_at("type", "is missing")),
        };
        let count = object.required_index("count")?;
        if u32::try_from(count).is_err() {
            return Err(
                object.malformed_at("count", format!("{count} elements are more than any index can name"))
            );
        }
        let accessor = Self {
            count,
            width,
            component: Component::parse(&object)?,
            normalized: object.boolean("normalized").unwrap_or(false),
            view: object.reference("bufferView", &resources.root, "bufferViews")?,
            offset: object.index("byteOffset")?.unwrap_or(0),
            object,
        };
        let has_data = accessor.view.is_some();
        if !has_data && count > MAX_ZERO_ELEMENTS {
            return Err(ImportError::OverLimit {
                file: resources.root.file().to_owned(),
                place: accessor.object.place_of("count"),
                what: "elements of an accessor without bufferView",
                value: count as u64,
                limit: MAX_ZERO_ELEMENTS as u64,
                fix: "give it a bufferView",
            });
        }
        Ok(accessor)
    }

    /// A complaint about this accessor.
    pub(super) fn malformed(&self, rule: impl Into<String>) -> ImportError {
        self.object.malformed(rule)
    }

    /// Where this accessor stands.
    pub(super) fn place(&self) -> String {
        self.object.place()
    }

    /// Proves that all elements are there, before anything is made of their number.
    pub(super) fn check_extent(&self, resources: &Resources<'_>) -> Result<(), ImportError> {
        let Some(view) = self.view else { return Ok(()) };
        let element_bytes = self.component.bytes() * self.width;
        self.elements(resources, &self.object, (view, self.offset), self.count, element_bytes).map(|_| ())
    }

    /// Finds `count` elements of `element_bytes` in a buffer view, and proves that they are all there.
    fn elements<'r>(
        &self,
        resources: &'r Resources<'_>,
        object: &Json<'_>,
        (view, offset): (usize, usize),
        count: usize,
        element_bytes: usize,
    ) -> Result<Elements<'r>, ImportError> {
        let place = view;
        let view = resources.view(view)?;
        let stride = view.stride.unwrap_or(element_bytes);
        let available = view.bytes.len();
        let end =
            count.checked_sub(1).map_or(Some(0), |last| last.checked_mul(stride)?.checked_add(element_bytes));
        let end = end.and_then(|end| end.checked_add(offset));
        if end.is_none_or(|end| end > available) {
            return Err(object.malformed(format!(
                "{count} elements of {element_bytes} bytes, {stride} apart, from byte {offset} on, reach beyond the {available} bytes of bufferViews[{place}]"
            )));
        }
        Ok(Elements { bytes: view.bytes.get(offset..).unwrap_or_default(), stride })
    }

    /// The selected elements as numbers, `width` of each.
    pub(super) fn read(
        &self,
        resources: &Resources<'_>,
        selection: Selection<'_>,
        place: &str,
    ) -> Result<Vec<f32>, ImportError> {
        self.check_extent(resources)?;
        let selected = selection.map_or(self.count, <[u32]>::len);
        resources.charge((selected * self.width * 4) as u64, place)?;
        let size = self.component.bytes();
        let mut values = match self.view {
            None => vec![0.0; selected * self.width],
            Some(view) => {
                let elements = self.elements(
                    resources,
                    &self.object,
                    (view, self.offset),
                    self.count,
                    size * self.width,
                )?;
                let mut values = Vec::with_capacity(selected * self.width);
                let mut push = |index: usize| {
                    let element = elements.get(index);
                    values.extend((0..self.width).map(|i| self.value(&element[i * size..])));
                };
                match selection {
                    None => (0..self.count).for_each(&mut push),
                    Some(selection) => selection.iter().for_each(|index| push(*index as usize)),
                }
                values
            }
        };
        self.substitute(resources, |index, element| {
            let at = match selection {
                None => index as usize,
                Some(selection) => match selection.binary_search(&index) {
                    Ok(at) => at,
                    Err(_) => return,
                },
            };
            for (i, value) in values[at * self.width..][..self.width].iter_mut().enumerate() {
                *value = self.value(&element[i * size..]);
            }
        })?;
        Ok(values)
    }

    fn value(&self, bytes: &[u8]) -> f32 {
        let value = self.component.read(bytes);
        if self.normalized { (value * self.component.unit()).max(-1.0) } else { value }
    }

    /// All elements as vertex indices.
    pub(super) fn read_indices(
        &self,
        resources: &Resources<'_>,
        place: &str,
    ) -> Result<Vec<u32>, ImportError> {
        if self.width != 1 || !matches!(self.component, Component::U8 | Component::U16 | Component::U32) {
            return Err(self.malformed("vertex indices must be unsigned scalars"));
        }
        self.check_extent(resources)?;
        resources.charge((self.count * 4) as u64, place)?;
        let size = self.component.bytes();
        let mut indices = match self.view {
            None => vec![0; self.count],
            Some(view) => {
                let elements =
                    self.elements(resources, &self.object, (view, self.offset), self.count, size)?;
                (0..self.count).map(|index| self.component.read_index(elements.get(index))).collect()
            }
        };
        self.substitute(resources, |index, element| {
            indices[index as usize] = self.component.read_index(element);
        })?;
        Ok(indices)
    }

    /// Calls `set(index, bytes)` for every element that the sparse part replaces.
    fn substitute(
        &self,
        resources: &Resources<'_>,
        mut set: impl FnMut(u32, &[u8]),
    ) -> Result<(), ImportError> {
        let Some(sparse) = self.object.object("sparse")? else { return Ok(()) };
        let count = sparse.required_index("count")?;
        if count > self.count {
            return Err(
                sparse.malformed(format!("{count} elements replace more than there are, {}", self.count))
            );
        }
        resources.charge(count as u64 * 8, &sparse.place())?;
        let part = |key: &str| sparse.object(key)?.ok_or_else(|| sparse.malformed_at(key, "is missing"));
        let (indices, values) = (part("indices")?, part("values")?);
        let at = |part: &Json<'_>| {
            Ok::<_, ImportError>((part.required_index("bufferView")?, part.index("byteOffset")?.unwrap_or(0)))
        };
        let kind = Component::parse(&indices)?;
        if !matches!(kind, Component::U8 | Component::U16 | Component::U32) {
            return Err(indices.malformed_at("componentType", "must be an unsigned integer"));
        }
        let element_bytes = self.component.bytes() * self.width;
        let index_elements = self.elements(resources, &indices, at(&indices)?, count, kind.bytes())?;
        let value_elements = self.elements(resources, &values, at(&values)?, count, element_bytes)?;
        for i in 0..count {
            let index = kind.read_index(index_elements.get(i));
            if index as usize >= self.count {
                return Err(indices
                    .malformed(format!("element {i} is {index}, but there are {} elements", self.count)));
            }
            set(index, &value_elements.get(i)[..element_bytes]);
        }
        Ok(())
    }
}
