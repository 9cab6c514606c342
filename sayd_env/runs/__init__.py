"""One policy or none on one vehicle in one condition, many times: policies, rollouts, metrics, run cache, executors."""
