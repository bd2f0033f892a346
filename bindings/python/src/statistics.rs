//! Statistics of a client, as a dictionary.

use pyo3::prelude::*;
use pyo3::types::PyDict;
use rhumb_bindings::rhumb_client::Statistics;

/// Statistics since the client connected.
pub(crate) fn dictionary<'py>(py: Python<'py>, now: &Statistics) -> PyResult<Bound<'py, PyDict>> {
    let statistics = PyDict::new(py);
    statistics.set_item("sent_bytes", now.wire.sent_bytes)?;
    statistics.set_item("received_bytes", now.wire.received_bytes)?;
    statistics.set_item("updates", now.stream.updates)?;
    statistics.set_item("complete_tick", now.complete.value())?;
    let upstream = PyDict::new(py);
    upstream.set_item("updates", now.upstream.updates)?;
    upstream.set_item("packets", now.upstream.packets)?;
    upstream.set_item("bytes", now.upstream.bytes)?;
    statistics.set_item("upstream", upstream)?;
    statistics.set_item("behind_ticks", now.behind_ticks)?;
    Ok(statistics)
}
