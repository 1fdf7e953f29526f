"""The paper's row, solved exactly from event to event."""
