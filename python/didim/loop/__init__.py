"""The closed loop: references, controllers, simulation."""
