//! Builds the graph of tasks that a level needs, and their keys.
