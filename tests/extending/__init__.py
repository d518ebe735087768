"""Extensions of optlink as contributors write them, each in one module outside the package."""
