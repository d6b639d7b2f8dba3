"""Packing plans: how they are read and checked, and how they are stored as arrays."""

from __future__ import annotations

from petmjx.plans.plan import Plan
from petmjx.plans.plan_reader import DEFAULT_MAX_BOXES, load_plans
from petmjx.plans.plan_set import PlanSet, Skipped

__all__ = ["DEFAULT_MAX_BOXES", "Plan", "PlanSet", "Skipped", "load_plans"]
