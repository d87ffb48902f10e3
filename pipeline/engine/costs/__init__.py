"""What a run will take, and what leaving something out saves: estimates of the stages at rates that this machine has shown."""

from pipeline.engine.costs.cost import COMPILING, ITSELF, Cost

__all__ = ["COMPILING", "ITSELF", "Cost"]
