//! A cursor over parsed JSON that knows its place, so that every complaint can name it.
//!
//! Only what the bake reads is checked: unknown fields, unknown extensions and broken parts that nothing needs do no
//! harm.

use super::error::ImportError;
use serde_json::Value;

/// A JSON value and its place in the file, such as `meshes[3].primitives[0]`.
#[derive(Debug, Clone)]
pub(super) struct Json<'a> {
    value: &'a Value,
    file: &'a str,
    place: String,
}

impl<'a> Json<'a> {
    /// The whole document of `file`.
    pub(super) fn root(file: &'a str, value: &'a Value) -> Self {
        Self { value, file, place: String::new() }
    }

    /// Name of the scene file.
    pub(super) fn file(&self) -> &'a str {
        self.file
    }

    /// Where this value stands.
    pub(super) fn place(&self) -> String {
        if self.place.is_empty() { "the document".to_owned() } else { self.place.clone() }
    }

    /// Where a field of this value stands.
    pub(super) fn place_of(&self, key: &str) -> String {
        if self.place.is_empty() { key.to_owned() } else { format!("{}.{key}", self.place) }
    }

    /// A complaint about this value.
    pub(super) fn malformed(&self, rule: impl Into<String>) -> ImportError {
        ImportError::Malformed { file: self.file.to_owned(), place: self.place(), rule: rule.into() }
    }

    /// A complaint about a field of this value.
    pub(super) fn malformed_at(&self, key: &str, rule: impl Into<String>) -> ImportError {
        ImportError::Malformed { file: self.file.to_owned(), place: self.place_of(key), rule: rule.into() }
    }

    /// The object's keys in the order of their names, or none if this is no object.
    pub(super) fn keys(&self) -> Vec<&'a str> {
        let mut keys: Vec<&str> = self
            .value
            .as_object()
            .map(|object| object.keys().map(String::as_str).collect())
            .unwrap_or_default();
        keys.sort_unstable();
        keys
    }

    fn field(&self, key: &str) -> Option<&'a Value> {
        self.value.get(key).filter(|value| !value.is_null())
    }

    /// The object under `key`, if there is one.
    pub(super) fn object(&self, key: &str) -> Result<Option<Json<'a>>, ImportError> {
        match self.field(key) {
            None => Ok(None),
            Some(value) if value.is_object() => {
                Ok(Some(Json { value, file: self.file, place: self.place_of(key) }))
            }
            Some(_) => Err(self.malformed_at(key, "must be an object")),
        }
    }

    /// The extension `name` of this object; anything but an object counts as missing.
    pub(super) fn extension(&self, name: &str) -> Option<Json<'a>> {
        let value = self.field("extensions")?.get(name).filter(|value| value.is_object())?;
        Some(Json { value, file: self.file, place: self.place_of(&format!("extensions.{name}")) })
    }

    /// Entries of the array under `key`; a missing array is empty.
    pub(super) fn len(&self, key: &str) -> Result<usize, ImportError> {
        match self.field(key) {
            None => Ok(0),
            Some(Value::Array(array)) => Ok(array.len()),
            Some(_) => Err(self.malformed_at(key, "must be an array")),
        }
    }

    /// Entry `index` of the array under `key`, which must be an object.
    pub(super) fn item(&self, key: &str, index: usize) -> Result<Json<'a>, ImportError> {
        let len = self.len(key)?;
        let place = self.place_of(&format!("{key}[{index}]"));
        let Some(value) = self.field(key).and_then(|array| array.get(index)) else {
            let rule = format!("does not exist; there are {len} {key}");
            return Err(ImportError::Malformed { file: self.file.to_owned(), place, rule });
        };
        let item = Json { value, file: self.file, place };
        if value.is_object() { Ok(item) } else { Err(item.malformed("must be an object")) }
    }

    /// All entries of the array of objects under `key`.
    pub(super) fn items(&self, key: &str) -> Result<Vec<Json<'a>>, ImportError> {
        (0..self.len(key)?).map(|index| self.item(key, index)).collect()
    }

    /// The array of indices under `key`; a missing array is empty.
    pub(super) fn indices(&self, key: &str) -> Result<Vec<usize>, ImportError> {
        let Some(value) = self.field(key) else { return Ok(Vec::new()) };
        let array = value.as_array().ok_or_else(|| self.malformed_at(key, "must be an array of indices"))?;
        let index = |value| {
            whole(value).ok_or_else(|| self.malformed_at(key, "must hold non-negative integers only"))
        };
        array.iter().map(index).collect()
    }

    /// The index under `key` into the array `array` of the document `root`, which must have such an entry.
    pub(super) fn reference(
        &self,
        key: &str,
        root: &Json<'_>,
        array: &str,
    ) -> Result<Option<usize>, ImportError> {
        let Some(index) = self.index(key)? else { return Ok(None) };
        self.check_reference(key, index, root, array).map(Some)
    }

    /// The indices under `key` into the array `array` of the document `root`, which must have such entries.
    pub(super) fn references(
        &self,
        key: &str,
        root: &Json<'_>,
        array: &str,
    ) -> Result<Vec<usize>, ImportError> {
        let indices = self.indices(key)?;
        indices.into_iter().map(|index| self.check_reference(key, index, root, array)).collect()
    }

    fn check_reference(
        &self,
        key: &str,
        index: usize,
        root: &Json<'_>,
        array: &str,
    ) -> Result<usize, ImportError> {
        let len = root.len(array)?;
        if index < len {
            return Ok(index);
        }
        Err(self.malformed_at(
            key,
            format!("refers to {array}[{index}], which does not exist; there are {len} {array}"),
        ))
    }

    /// The array of strings under `key`; entries of other types are left out.
    pub(super) fn strings(&self, key: &str) -> Vec<&'a str> {
        let array = self.field(key).and_then(Value::as_array);
        array.map(|array| array.iter().filter_map(Value::as_str).collect()).unwrap_or_default()
    }

    /// The non-negative integer under `key`; `3.0` is one.
    pub(super) fn index(&self, key: &str) -> Result<Option<usize>, ImportError> {
        match self.field(key) {
            None => Ok(None),
            Some(value) => match whole(value) {
                Some(index) => Ok(Some(index)),
                None => Err(self.malformed_at(key, "must be a non-negative integer")),
            },
        }
    }

    /// The non-negative integer under `key`, which must be there.
    pub(super) fn required_index(&self, key: &str) -> Result<usize, ImportError> {
        self.index(key)?.ok_or_else(|| self.malformed_at(key, "is missing"))
    }

    /// The number under `key`.
    pub(super) fn number(&self, key: &str) -> Result<Option<f64>, ImportError> {
        match self.field(key) {
            None => Ok(None),
            Some(value) => match value.as_f64().filter(|number| number.is_finite()) {
                Some(number) => Ok(Some(number)),
                None => Err(self.malformed_at(key, "must be a finite number")),
            },
        }
    }

    /// The array of exactly `N` numbers under `key`.
    pub(super) fn numbers<const N: usize>(&self, key: &str) -> Result<Option<[f64; N]>, ImportError> {
        let Some(numbers) = self.number_list(key)? else { return Ok(None) };
        match <[f64; N]>::try_from(numbers) {
            Ok(numbers) => Ok(Some(numbers)),
            Err(numbers) => {
                Err(self.malformed_at(key, format!("must hold {N} numbers, but holds {}", numbers.len())))
            }
        }
    }

    /// The array of numbers under `key`, of any length.
    pub(super) fn number_list(&self, key: &str) -> Result<Option<Vec<f64>>, ImportError> {
        let Some(value) = self.field(key) else { return Ok(None) };
        let complaint = || self.malformed_at(key, "must be an array of finite numbers");
        let array = value.as_array().ok_or_else(complaint)?;
        let number = |value: &Value| value.as_f64().filter(|number| number.is_finite()).ok_or_else(complaint);
        array.iter().map(number).collect::<Result<Vec<f64>, ImportError>>().map(Some)
    }

    /// The string under `key`.
    pub(super) fn string(&self, key: &str) -> Result<Option<&'a str>, ImportError> {
        match self.field(key) {
            None => Ok(None),
            Some(Value::String(string)) => Ok(Some(string)),
            Some(_) => Err(self.malformed_at(key, "must be a string")),
        }
    }

    /// The boolean under `key`, if it is one.
    pub(super) fn boolean(&self, key: &str) -> Option<bool> {
        self.field(key).and_then(Value::as_bool)
    }

    /// The object's `name`, or nothing.
    pub(super) fn name(&self) -> String {
        self.field("name").and_then(Value::as_str).unwrap_or_default().to_owned()
    }
}

/// A JSON number as an index: exporters write integers as floats at times.
fn whole(value: &Value) -> Option<usize> {
    const LARGEST_EXACT: f64 = 9_007_199_254_740_992.0;
    if let Some(integer) = value.as_u64() {
        return usize::try_from(integer).ok();
    }
    let number = value.as_f64()?;
    ((0.0..LARGEST_EXACT).contains(&number) && number.fract() == 0.0).then_some(number as usize)
}
