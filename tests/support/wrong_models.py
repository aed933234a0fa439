"""Errors planted in a reduced model, which a study must detect."""

from dataclasses import replace


def contacts_changed(model, **arrays):
    """The model with other values of its contacts."""
    return replace(model, contacts=replace(model.contacts, **arrays))


def without_friction(model):
    return contacts_changed(model, friction=0 * model.contacts.friction)


def gaps_off(model, distance):
    """All gaps larger by a distance, mm."""
    return contacts_changed(model, gap=model.contacts.gap + distance)


def compliance_scaled(model, factor):
    return replace(model, compliance=replace(model.compliance, H=tuple(factor * H for H in model.compliance.H)))
