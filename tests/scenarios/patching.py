"""Smaller studies: other constants, in every module of a study that has them."""


def patch_study(monkeypatch, modules, name, value):
    """Replace a constant in each of the modules that has it, and see that one has."""
    owners = [module for module in modules if hasattr(module, name)]
    assert owners, f"no module has {name}"
    for module in owners:
        monkeypatch.setattr(module, name, value)
