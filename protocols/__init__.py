"""How pursuers negotiate: one protocol, rule or schedule a file."""
