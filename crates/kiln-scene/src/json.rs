//! A look into the document's JSON that knows where it is, so that each error names its place.

use crate::SceneError;
use serde_json::{Map, Value};

pub(crate) const EXPORT_AGAIN: &str = "export the level again, or check it with a glTF validator";

/// A value of the document, with the way to it.
#[derive(Clone)]
pub(crate) struct Item<'a> {
    file: &'a str,
    value: &'a Value,
    place: String,
}

impl<'a> Item<'a> {
    /// The whole document.
    pub(crate) fn root(file: &'a str, value: &'a Value) -> Self {
        Self { file, value, place: String::new() }
    }

    pub(crate) fn file(&self) -> &'a str {
        self.file
    }

    pub(crate) fn value(&self) -> &'a Value {
        self.value
    }

    /// Where the value stands, such as `meshes[3].primitives[0]`.
    pub(crate) fn place(&self) -> &str {
        if self.place.is_empty() { "the document" } else { &self.place }
    }

    /// The same value with a remark after its place.
    pub(crate) fn remarked(mut self, remark: &str) -> Self {
        self.place = format!("{} ({remark})", self.place());
        self
    }

    /// A member, if it is there and not null.
    pub(crate) fn get(&self, key: &str) -> Option<Self> {
        let value = self.value.get(key).filter(|value| !value.is_null())?;
        let place = if self.place.is_empty() { key.to_owned() } else { format!("{}.{key}", self.place) };
        Some(Self { file: self.file, value, place })
    }

    /// A member that must be there.
    pub(crate) fn require(&self, key: &str) -> Result<Self, SceneError> {
        self.get(key).ok_or_else(|| self.invalid(format!("{key} is missing")))
    }

    /// A member of a member of `extensions`.
    pub(crate) fn extension(&self, name: &str) -> Option<Self> {
        self.get("extensions")?.get(name)
    }

    /// The elements of an array, or none if there is no such member.
    pub(crate) fn list(&self, key: &str) -> Result<List<'a>, SceneError> {
        let place = || if self.place.is_empty() { key.to_owned() } else { format!("{}.{key}", self.place) };
        match self.value.get(key) {
            None | Some(Value::Null) => Ok(List { file: self.file, values: &[], place: place() }),
            Some(Value::Array(values)) => Ok(List { file: self.file, values, place: place() }),
            Some(_) => Err(self.invalid(format!("{key} is not an array"))),
        }
    }

    pub(crate) fn object(&self) -> Result<&'a Map<String, Value>, SceneError> {
        self.value.as_object().ok_or_else(|| self.invalid("it is not an object"))
    }

    pub(crate) fn string(&self) -> Result<&'a str, SceneError> {
        self.value.as_str().ok_or_else(|| self.invalid("it is not a string"))
    }

    pub(crate) fn boolean(&self) -> Result<bool, SceneError> {
        self.value.as_bool().ok_or_else(|| self.invalid("it is neither true nor false"))
    }

    /// A number; JSON has finite ones only.
    pub(crate) fn number(&self) -> Result<f64, SceneError> {
        self.value.as_f64().ok_or_else(|| self.invalid("it is not a number"))
    }

    /// A non-negative integer; `3.0` counts as one.
    pub(crate) fn integer(&self) -> Result<u64, SceneError> {
        let from_float =
            |value: f64| (value >= 0.0 && value < 2f64.powi(53) && value.fract() == 0.0).then_some(value as u64);
        let integer = self.value.as_u64().or_else(|| self.value.as_f64().and_then(from_float));
        integer.ok_or_else(|| self.invalid("it is not a non-negative integer"))
    }

    /// A non-negative integer as an index, count or offset in memory.
    pub(crate) fn index(&self) -> Result<usize, SceneError> {
        usize::try_from(self.integer()?).map_err(|_| self.invalid("it is larger than any address"))
    }

    /// An array of exactly `N` numbers.
    pub(crate) fn numbers<const N: usize>(&self) -> Result<[f64; N], SceneError> {
        let values = self.value.as_array().filter(|values| values.len() == N);
        let values = values.ok_or_else(|| self.invalid(format!("it is not an array of {N} numbers")))?;
        let mut numbers = [0.0; N];
        for (number, value) in numbers.iter_mut().zip(values) {
            *number = value.as_f64().ok_or_else(|| self.invalid(format!("it is not an array of {N} numbers")))?;
        }
        Ok(numbers)
    }

    pub(crate) fn invalid(&self, problem: impl Into<String>) -> SceneError {
        self.invalid_with(problem, EXPORT_AGAIN)
    }

    pub(crate) fn invalid_with(&self, problem: impl Into<String>, advice: &'static str) -> SceneError {
        SceneError::Invalid {
            file: self.file.to_owned(),
            place: self.place().to_owned(),
            problem: problem.into(),
            advice,
        }
    }

    pub(crate) fn path_error(&self, uri: &str, problem: &'static str) -> SceneError {
        let mut shown: String = uri.chars().take(80).collect();
        if shown.len() < uri.len() {
            shown.push('…');
        }
        SceneError::Path { file: self.file.to_owned(), place: self.place().to_owned(), uri: shown, problem }
    }

    pub(crate) fn extension_error(&self, extension: &str, advice: &'static str) -> SceneError {
        SceneError::Extension {
            file: self.file.to_owned(),
            place: self.place().to_owned(),
            extension: extension.to_owned(),
            advice,
        }
    }

    pub(crate) fn too_big(&self, what: &'static str, found: u64, limit: u64, advice: &'static str) -> SceneError {
        SceneError::TooBig { file: self.file.to_owned(), place: self.place().to_owned(), what, found, limit, advice }
    }
}

/// An array of the document.
#[derive(Clone)]
pub(crate) struct List<'a> {
    file: &'a str,
    values: &'a [Value],
    place: String,
}

impl<'a> List<'a> {
    pub(crate) fn len(&self) -> usize {
        self.values.len()
    }

    pub(crate) fn get(&self, index: usize) -> Option<Item<'a>> {
        let value = self.values.get(index)?;
        Some(Item { file: self.file, value, place: format!("{}[{index}]", self.place) })
    }

    pub(crate) fn iter(&self) -> impl Iterator<Item = Item<'a>> + '_ {
        (0..self.len()).filter_map(|index| self.get(index))
    }

    /// The element that `reference`, an index elsewhere in the document, refers to.
    pub(crate) fn resolve(&self, reference: &Item<'_>) -> Result<(usize, Item<'a>), SceneError> {
        let index = reference.index()?;
        let missing = || format!("it refers to {}[{index}], but there are only {}", self.place, self.len());
        self.get(index).map(|item| (index, item)).ok_or_else(|| reference.invalid(missing()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn errors_name_the_place() {
        let value = json!({ "nodes": [{ "mesh": "x", "n": 3.0, "t": [1, 2] }] });
        let root = Item::root("a.gltf", &value);
        let node = root.list("nodes").unwrap().get(0).unwrap();
        let error = node.get("mesh").unwrap().index().unwrap_err().to_string();
        assert!(error.starts_with("a.gltf: nodes[0].mesh: it is not a non-negative integer; "), "{error}");
        assert_eq!(node.get("n").unwrap().index(), Ok(3));
        assert!(node.get("t").unwrap().numbers::<3>().is_err());
        assert_eq!(node.get("t").unwrap().numbers::<2>(), Ok([1.0, 2.0]));
    }

    #[test]
    fn references_are_checked() {
        let value = json!({ "nodes": [{}], "scene": 1, "half": 0.5, "negative": -1 });
        let root = Item::root("a.gltf", &value);
        let nodes = root.list("nodes").unwrap();
        for key in ["scene", "half", "negative"] {
            assert!(nodes.resolve(&root.get(key).unwrap()).is_err(), "{key}");
        }
        assert_eq!(root.list("absent").unwrap().len(), 0);
    }
}
