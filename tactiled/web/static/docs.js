// Starts Swagger UI: a script in the page itself is against the content security policy.

const { SwaggerUIBundle } = /** @type {any} */ (window);
SwaggerUIBundle({ dom_id: "#api", url: "/api/v1/openapi.json", deepLinking: true, validatorUrl: null });
