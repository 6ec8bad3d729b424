//! The scheduler's constants of policy.

use std::collections::BTreeMap;

/// What bounds one tenant.
#[derive(Clone, Debug, PartialEq)]
pub struct TenantLimits {
    /// Share of the farm relative to other tenants at equal priority; greater than 0.
    pub weight: f64,
    /// Most leases at once over all of the tenant's jobs.
    pub max_leases: usize,
}

impl Default for TenantLimits {
    fn default() -> Self {
        Self { weight: 1.0, max_leases: usize::MAX }
    }
}

/// Policy. Times are milliseconds of the clock that the caller passes to [`crate::Scheduler::apply`].
#[derive(Clone, Debug, PartialEq)]
pub struct Config {
    /// Work that a lease should hold, as seconds of its worker at its measured speed.
    pub lease_target_seconds: f64,
    /// Most tasks of a lease.
    pub max_lease_tasks: usize,
    /// A worker that is silent for this long is lost.
    pub heartbeat_timeout_ms: u64,
    /// A worker whose connection broke may come back within this time and keep its leases.
    pub reconnect_grace_ms: u64,
    /// A lease that runs longer than this counts as a failure of its first unfinished task.
    pub max_lease_ms: u64,
    /// A job that waits gains one step of priority each time this passes.
    pub ageing_ms: u64,
    /// Failures on this many different workers fail the job (or as many attempts, where fewer workers fit).
    pub max_task_failures: usize,
    /// Workers that may be lost with a task in hand before the job fails.
    pub max_worker_losses: u32,
    /// Times that workers may hand a task back before the job fails.
    pub max_returns: u32,
    /// A task that was handed back waits this long, doubled each further time (at most 64-fold).
    pub return_delay_ms: u64,
    /// A worker whose tasks fail in a row waits this long before its next lease, doubled each further time.
    pub failure_delay_ms: u64,
    /// A worker that failed this many tasks that others then completed is set aside.
    pub set_aside_after: u32,
    /// A lease is run a second time when it takes this many times what [`Self::straggler_quantile`] of its peers took.
    pub straggler_factor: f64,
    /// The quantile of finished leases that a straggler is compared with, in (0, 1].
    pub straggler_quantile: f64,
    /// No lease younger than this is a straggler.
    pub straggler_min_ms: u64,
    /// A job for which no connected worker fits fails after this time; `None` waits for ever.
    pub no_fit_timeout_ms: Option<u64>,
    /// Limits of tenants by name.
    pub tenants: BTreeMap<String, TenantLimits>,
    /// Limits of every other tenant.
    pub default_tenant: TenantLimits,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            lease_target_seconds: 2.0,
            max_lease_tasks: 4096,
            heartbeat_timeout_ms: 15_000,
            reconnect_grace_ms: 3_000,
            max_lease_ms: 3_600_000,
            ageing_ms: 60_000,
            max_task_failures: 3,
            max_worker_losses: 5,
            max_returns: 20,
            return_delay_ms: 250,
            failure_delay_ms: 250,
            set_aside_after: 3,
            straggler_factor: 2.0,
            straggler_quantile: 0.75,
            straggler_min_ms: 1_000,
            no_fit_timeout_ms: Some(60_000),
            tenants: BTreeMap::new(),
            default_tenant: TenantLimits::default(),
        }
    }
}
