"""The net under a change of form: what every example says, before and after, to the last digit."""
