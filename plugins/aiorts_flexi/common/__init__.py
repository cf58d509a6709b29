"""The common part of all Flexi components: options, port specifications, literals, the base class, and sending."""
